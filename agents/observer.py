"""Train a learned observer (`baselines.learned.learned_observer`) from driven episodes.

    python -m agents.observer --seed 0 --output runs/learned-observer-seed0 --processes 2
Rounds of two steps each, and at the end the archive agent.zip:
    drive     episodes of every law, kind of sensors, reference and plant of `driven_episodes`,
              under controllers whose gains are drawn, so that the network is tied to none. From the
              second round on, 80 % of them with the network in the loop: it learns from what it
              then meets (DAgger [1])
    regress   true motion less the shown one, in the units of the filter, by a Huber loss of what
              is left, of its slow parts and of its changes: a controller follows an error that
              lasts, and answers a jump with torque. Beside it the logarithm of the deviation of
              what is left (Gaussian likelihood) and, as an auxiliary task, the errors of the
              identified parameters. Truncated back-propagation through time with a state that is
              carried on
Every eighth episode is held out; on those of the last round the claimed deviations are scaled, so
that COVERED of the errors are within WITHIN of them. The same command goes on where it was stopped.
Needs torch, and no other library for training; `--device cuda` keeps all data on the device.

References: [1] Ross et al., arXiv:1011.0686.
"""

import sys
from typing import Any

import numpy as np
import torch
from torch import nn

from agents import driven_episodes as episodes
from agents import regression
from agents.driven_episodes import GAINS, PARAMETERS
from agents.regression import GatedNetwork, LowPass, Regression
from baselines.learned.agent_policy import OBSERVER
from baselines.learned.gated_network import Layers
from baselines.learned.learned_observer import (
    DISAGREEMENTS,
    FEATURES,
    LIMIT,
    MOTION,
    SPREADS,
    observer_layers,
)

COVERED, WITHIN = 0.975, 2.5  # [-] of errors, deviations
# Time constants [s] of the low passes of what is left, and what makes its size that of the whole.
SLOW = ((0.3, 1.5), (1.0, 2.5), (3.0, 4.0))
FAST = 3.0  # [-] the same of its change in a control step, which a controller answers with torque
# [-] of each of MOTION in the loss, by what its truth is worth to predictive control: positions
# nearly everything, the forward speed a part; lateral speed and yaw rate hardly anything.
IMPORTANCE = (2.0, 2.0, 0.5, 1.0, 0.1, 0.2)
AUXILIARY, SPREAD_WEIGHT = 0.05, 0.1  # [-] of the losses beside that of the motion
SIZE = len(MOTION)


class Observer:
    """The task, see `regression.Task`."""

    job, driven, averages = episodes.JOB, episodes.DRIVEN, False
    columns = tuple(
        name + part for part in ("", *(f"_{tau:g}_s" for tau, _ in SLOW)) for name in MOTION
    )
    drive = staticmethod(episodes.drive)

    def __init__(self, options: Any) -> None:
        self.options = options
        torch.manual_seed(options.seed)
        torch.set_num_threads(options.threads)
        mask = torch.ones(len(FEATURES))
        if not options.innovations:
            mask[[FEATURES.index(name) for name in DISAGREEMENTS]] = 0.0
        further = len(PARAMETERS) + len(GAINS)
        self.network = GatedNetwork(2 * SIZE, further, mask, options.recurrent)
        self.low_pass = LowPass([tau for tau, _ in SLOW], torch.device(options.device))

    def layers(self, weights: Any) -> Layers:
        """Layers of the network in the loop."""
        return observer_layers(weights, self.options.recurrent)

    def epochs(self, number: int) -> int:
        """Of a round."""
        return int(self.options.epochs)

    def schedule(self, number: int, epoch: int) -> tuple[float, int]:
        """Learning rate, which falls in each round, and control steps of a chunk."""
        o, share = self.options, epoch / self.options.epochs
        rate = (o.rate if number == 0 else 0.5 * o.rate) * (0.05 + 0.95 * (1.0 - share))
        return rate, o.chunk if number == 0 and share < 0.5 else 2 * o.chunk

    def losses(self, x: Any, y: Any, valid: Any, state: Any) -> tuple[Any, Any, Any]:
        """Loss, the part of the motion, and the state after x (T, B, F), targets y, valid
        (T, B, 1)."""
        carried, slow = (None, None) if state is None else state
        out, parameters, carried = self.network(x, carried)
        shown, spread = out[..., :SIZE], out[..., SIZE:].clamp(*SPREADS)
        true, count = y[..., :SIZE], valid.sum().clamp(min=1.0)
        left = (true - shown) * valid
        slow = self.low_pass(left, slow)
        parts = [left, *(gain * each * valid for each, (_, gain) in zip(slow, SLOW, strict=True))]
        parts.append(FAST * (left[1:] - left[:-1]) * valid[1:])
        importance, motion = left.new_tensor(IMPORTANCE), left.new_zeros(())
        for part in parts:
            losses = nn.functional.huber_loss(part, torch.zeros_like(part), reduction="none")
            motion = motion + (importance * losses).sum() / (count * importance.sum())
        square = (true - shown.detach().clamp(-LIMIT, LIMIT)) ** 2
        likelihood = spread + 0.5 * square * torch.exp(-2.0 * spread)
        beside = nn.functional.smooth_l1_loss(parameters, y[..., SIZE:], reduction="none")
        loss = motion + SPREAD_WEIGHT * ((likelihood * valid).sum() / count / SIZE)
        loss = loss + AUXILIARY * ((beside * valid).sum() / count / beside.shape[-1])
        last = [each[-1].detach() for each in slow]
        return loss, motion.detach(), (None if carried is None else carried.detach(), last)

    @torch.no_grad()
    def report(self, of: Regression) -> list[float]:
        """RMS of what is left of each of MOTION over that without a network on what is held out,
        as it is, then its parts slower than each of SLOW."""
        sums = np.zeros((2, 1 + len(SLOW), SIZE))
        for valid, true, shown, _ in self._held_out(of, False):
            for total, left in zip(sums, (true - shown, true), strict=True):
                for row, each in zip(total, (left, *self._slow(left)), strict=True):
                    row += (each[valid] ** 2).sum(0).double().cpu().numpy()
        ratios: list[float] = np.sqrt(sums[0] / sums[1]).ravel().tolist()
        return ratios

    @torch.no_grad()
    def finish(self, of: Regression) -> None:
        """Scale the deviations by what is held out of the last round."""
        ratios = [
            ((true - shown).abs() / spread.exp())[valid].cpu().numpy()
            for valid, true, shown, spread in self._held_out(of, True)
        ]
        wider = np.quantile(np.concatenate(ratios), COVERED, axis=0) / WITHIN
        self.network.last.bias[SIZE:] += torch.from_numpy(np.log(wider)).to(of.device)

    def _slow(self, left: Any) -> list[Any]:
        return [g * each for each, (_, g) in zip(self.low_pass(left), SLOW, strict=True)]

    def _held_out(self, of: Regression, last: bool) -> Any:
        """Where there is one, the true motion, the shown one and the logarithm of its deviation."""
        for features, targets, lengths in of.batches(True, None, 128, last):
            valid = torch.arange(features.shape[0], device=of.device)[:, None] < lengths
            out = self.network(features.float())[0]
            shown, spread = out[..., :SIZE].clamp(-LIMIT, LIMIT), out[..., SIZE:].clamp(*SPREADS)
            yield valid, targets.float()[..., :SIZE], shown, spread

    def recipe(self) -> dict[str, Any]:
        """What an archive says of its kind."""
        o = self.options
        return {
            "augmentation": OBSERVER,
            "augmentation_options": {"base": episodes.BASE, "recurrent": o.recurrent},
            "command": " ".join(["python -m agents.observer", *o.words]),
        }


def parse(words: list[str]) -> Any:
    """The options of the command line."""
    parser = regression.parser_of(
        (__doc__ or "").partition("\n")[0],
        episodes=1076, further=538, rounds=2, epochs=12, batch=32,
    )  # fmt: skip
    add = parser.add_argument
    add("--no-innovations", dest="innovations", action="store_false", help="do not see them")
    options = parser.parse_args(words)
    options.words = words
    return options


if __name__ == "__main__":
    options = parse(sys.argv[1:])
    regression.train(options, Observer(options))
