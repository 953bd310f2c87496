"""What trainings share in which a network imitates a teacher, see `regression.Task`.

The loss is a Huber loss of what is left of the targets and of its slow parts, since a vehicle
follows an error that lasts, and of an auxiliary task. The teacher drives some vehicles of a round,
in actions that are disturbed.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import nn

from agents.regression import PERIOD, GatedNetwork, LowPass, Regression
from baselines.batch_policy import Array

SLOW = ((0.3, 2.0), (1.0, 3.0))  # [s] of low passes, and what they weigh beside the targets
TURNING = 2.0  # [-] what the difference of the sides weighs, which steers, over their sum
AUXILIARY = 0.2  # [-]
DISTURBANCE = 0.3  # [s] for which what disturbs the teacher lasts


def sum_and_difference(sides: Any) -> Any:
    """What is left (..., 2) of the actions of both sides, as it weighs."""
    both, apart = sides.sum(-1), TURNING * (sides[..., 1] - sides[..., 0])
    return torch.stack([both, apart], dim=-1) / math.sqrt(2.0)


class Disturbance:
    """Disturbances of the actions of N vehicles, of a deviation up to `largest` [-] each."""

    def __init__(self, rng: np.random.Generator, count: int, largest: float) -> None:
        self._rng, self._keep = rng, math.exp(-PERIOD / DISTURBANCE)
        self._size = largest * rng.random((count, 1)) * math.sqrt(1.0 - self._keep**2)
        self._value = np.zeros((count, 2))

    def next(self) -> Array:
        """Those of the next control step, (N, 2)."""
        noise = self._rng.normal(size=self._value.shape)
        self._value = self._keep * self._value + self._size * noise
        return self._value


class Imitation:
    """A task; a subclass has `left`, `drive`, `layers`, `report`, `columns` and `recipe`.

    inputs, outputs, further: of the network. slow: as SLOW.
    """

    driven, averages = 1.0, True  # which vehicles of a job the teacher drives is drawn

    def __init__(
        self, options: Any, inputs: int, outputs: int, further: int, slow: Sequence[Any] = SLOW
    ) -> None:
        self.options, self.further = options, further
        torch.manual_seed(options.seed)
        torch.set_num_threads(options.threads)
        self.network = GatedNetwork(outputs, further, torch.ones(inputs), options.recurrent)
        self.low_pass = LowPass([tau for tau, _ in slow], torch.device(options.device))
        self._gains = [gain for _, gain in slow]

    def left(self, y: Any, out: Any) -> Any:
        """What is left (T, B, C) of targets y when the network says `out`, as it weighs."""
        raise NotImplementedError

    def epochs(self, number: int) -> int:
        """The last round has more."""
        o = self.options
        return int(o.epochs if number < o.rounds else o.last_epochs)

    def schedule(self, number: int, epoch: int) -> tuple[float, int]:
        """Falls to a twentieth over all epochs."""
        o = self.options
        whole = o.rounds * o.epochs + o.last_epochs
        share = (number * o.epochs + epoch) / whole
        return o.rate * (0.05 + 0.95 * (1.0 - share)), o.chunk if share < 0.5 else 2 * o.chunk

    def losses(self, x: Any, y: Any, valid: Any, state: Any) -> tuple[Any, Any, Any]:
        """See the head of the file; the auxiliary targets are the last of y."""
        carried, slow = (None, None) if state is None else state
        out, further, carried = self.network(x, carried)
        left, count = self.left(y, out) * valid, valid.sum().clamp(min=1.0)
        slow = self.low_pass(left, slow)
        acts = left.new_zeros(())
        for part, gain in ((left, 1.0), *zip(slow, self._gains, strict=True)):
            losses = nn.functional.huber_loss(gain * part, torch.zeros_like(part), reduction="none")
            acts = acts + (losses * valid).sum() / (2.0 * count)
        known = y[..., -self.further :]
        beside = nn.functional.smooth_l1_loss(further, known, reduction="none")
        loss = acts + AUXILIARY * (beside * valid).sum() / count / self.further
        last = [each[-1].detach() for each in slow]
        return loss, acts.detach(), (None if carried is None else carried.detach(), last)

    def finish(self, of: Regression) -> None:
        """Nothing is left to do."""
