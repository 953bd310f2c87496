"""The training of a student with an LSTM (`baselines.learned.recurrent_student`).

As every student it drives from the first step on. What it meets goes into the buffer in blocks of
`n_steps`, with what the LSTM carried when the block began; the inference is regressed on sequences
of that length by back-propagation through time. What was carried comes from earlier blocks, so that
the memory reaches further back than a block does.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import nn

from agents.inference import RecurrentInference, RecurrentStudentModel
from agents.training.run import Run
from agents.training.student_learner import StudentLearner
from baselines.learned.agent_policy import Normalisation
from baselines.learned.recurrent_student import OUTPUTS
from baselines.learned.student_network import features_of

LARGEST_GRADIENT = 1.0  # [-] norm that a gradient is shortened to


class RecurrentStudentLearner(StudentLearner):
    """A student with an LSTM, of the teacher of a run.

    Raises ValueError as StudentLearner, for an observation without the motion, and for estimates
    where sprocket speeds are commanded.
    """

    outputs = OUTPUTS

    def __init__(self, run: Run) -> None:
        features_of(run.augmentation.options, run.parts[0].context.drive)  # refuses some
        super().__init__(run)
        rows, count = self._rows, self.env.num_envs
        self._began = torch.zeros(rows, count, 1)
        blocks = rows // self.settings.n_steps
        self._carried = torch.zeros(2, blocks, count, self.settings.lstm_hidden)

    def _model(self, scaling: Normalisation | None) -> RecurrentStudentModel:
        shown = self.env.observation_space.shape
        assert shown is not None
        settings = self.settings
        inference = RecurrentInference(shown[0], settings.hidden, settings.lstm_hidden)
        names = [field for of_group in self.groups.values() for field in of_group]
        return RecurrentStudentModel(inference, self.teacher, scaling, names, settings.features)

    @property
    def truth(self) -> Any:
        """What the inference should say of the present observation, (N, F) of all rows."""
        motion = np.concatenate([truth.motion() for truth in self.truths])
        hidden = np.concatenate([truth.present for truth in self.truths])
        return self.model.wanted(self._observation, motion, hidden)

    def collect(self) -> float:
        """Drive one block; returns how wrong the inference was meanwhile, as `_loss`."""
        block = self._filled % self._rows // self.settings.n_steps
        carried = None if self._state is None else self._state[0]
        for kept, values in zip(self._carried[:, block], carried or (0.0, 0.0), strict=True):
            kept[:] = torch.as_tensor(values)
        losses = 0.0
        for _ in range(self.settings.n_steps):
            row = self._filled % self._rows
            self._seen[row] = torch.from_numpy(self._observation)
            self._true[row] = torch.from_numpy(self.truth)
            self._began[row, :, 0] = torch.from_numpy(self._start.astype(np.float32))
            action, self._state = self.model.predict(
                self._observation, self._state, self._start, deterministic=True
            )
            losses += float(_loss(torch.from_numpy(self.model.found), self._true[row]))
            self._observation, _, self._start, _ = self.env.step(action)
            self._filled += 1
        self.steps += self.settings.n_steps * self.env.num_envs
        return losses / self.settings.n_steps

    def regress(self, rate: float) -> None:
        """Gradient steps on sequences of the buffer. rate: learning rate."""
        length, count = self.settings.n_steps, self.env.num_envs
        blocks = min(self._filled, self._rows) // length
        size = max(self.settings.batch_size // length, 1)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        seen, true, began = (
            values.view(-1, length, *values.shape[1:])
            for values in (self._seen, self._true, self._began)
        )
        network = self.model.inference
        for _ in range(self.settings.gradient_steps):
            block, row = (
                torch.from_numpy(self._random.integers(most, size=size)) for most in (blocks, count)
            )
            of_time = [values[block, :, row].transpose(0, 1) for values in (seen, began, true)]
            carried = self._carried[0, block, row], self._carried[1, block, row]
            loss = _loss(network(of_time[0], of_time[1], carried)[0], of_time[2])
            self.optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), LARGEST_GRADIENT)
            self.optimiser.step()

    def capture(self) -> dict[str, Any]:
        """Everything that the next samples and regressions depend on."""
        return {
            **super().capture(), "began": self._began.numpy(), "carried": self._carried.numpy()
        }  # fmt: skip

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took. Raises any exception where it does not fit."""
        super().resume(captured)
        self._began[:] = torch.from_numpy(captured["began"])
        self._carried[:] = torch.from_numpy(captured["carried"])


def _loss(found: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    """Mean of the squared error / 2 below 1, of its magnitude - 1/2 above: a vehicle far off its
    path counts, but does not outweigh all others."""
    return nn.functional.smooth_l1_loss(found, true)
