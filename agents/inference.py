"""The network of a student while it learns: in PyTorch, beside the network of its teacher."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.networks import to_npz
from baselines.learned.agent_policy import Normalisation, Predictor
from baselines.learned.recurrent_student import MEMORY, OUTPUTS, RecurrentStudent
from baselines.learned.student_network import INFERENCE_FORMAT, Student, inference_sizes
from tracked_env import observation as layout

Floats = NDArray[np.float32]
Carried = tuple[torch.Tensor, torch.Tensor]  # hidden and cell values of an LSTM


def make_inference(
    lags: tuple[int, ...], hidden: tuple[int, ...], observed: int = layout.SIZE, sheet: bool = False
) -> nn.Sequential:
    """An untrained network from observation and history to the privileged inputs.

    It begins by saying 0, nominal: its last layer is zero. observed: number of fields of the
    observation. sheet: whether the data sheet stands behind the history.
    """
    return _perceptron(inference_sizes(lags, hidden, observed, sheet))


def _perceptron(sizes: Sequence[int]) -> nn.Sequential:
    """ELUs between linear layers, of which the last is zero."""
    parts: list[nn.Module] = []
    for size, following in pairwise(sizes[:-1]):
        parts += [nn.Linear(size, following), nn.ELU()]
    last = nn.Linear(sizes[-2], sizes[-1])
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*parts, last)


class RecurrentInference(nn.Module):
    """An LSTM beside its inputs, then a perceptron; it begins by saying 0.

    inputs, hidden, lstm_hidden: sizes. Weights have the names of `recurrent_student`.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], lstm_hidden: int) -> None:
        super().__init__()
        self.lstm = nn.LSTMCell(inputs, lstm_hidden)
        self.layers = _perceptron((inputs + lstm_hidden, *hidden, OUTPUTS))
        with torch.no_grad():  # of the forget gate: it remembers from the beginning
            self.lstm.bias_ih[lstm_hidden : 2 * lstm_hidden] += 2.0

    def forward(
        self, inputs: torch.Tensor, start: torch.Tensor, carried: Carried
    ) -> tuple[torch.Tensor, Carried]:
        """Outputs (T, N, F) of inputs (T, N, D), and what is carried on; start (T, N, 1)."""
        remembered = []
        for seen, begins in zip(inputs, start, strict=True):
            kept = 1.0 - begins
            carried = self.lstm(seen, (carried[0] * kept, carried[1] * kept))
            remembered.append(carried[0])
        return self.layers(torch.cat([torch.stack(remembered), inputs], dim=-1)), carried

    def blank(self, count: int) -> Carried:
        """What `count` rows carry before anything was seen."""
        return torch.zeros(count, self.lstm.hidden_size), torch.zeros(count, self.lstm.hidden_size)


class RecurrentStudentModel(RecurrentStudent):
    """A recurrent student whose inference is a network of PyTorch; the others as there."""

    def __init__(
        self, inference: RecurrentInference, teacher: Predictor,
        normalisation: Normalisation | None, names: Sequence[str], features: str = "reckoned",
    ) -> None:  # fmt: skip
        super().__init__(self._inferred, teacher, normalisation, names, features)
        self.inference = inference

    def _inferred(self, inputs: Floats, carried: Any, start: Any) -> tuple[Floats, Any]:
        """One step; carried: arrays (N, H) of hidden and cell values, or None."""
        known = self.inference.blank(len(inputs))
        if carried is not None:
            known = torch.from_numpy(carried[0]), torch.from_numpy(carried[1])
        begins = torch.from_numpy(np.asarray(start, np.float32)[None, :, None])
        with torch.no_grad():
            found, known = self.inference(torch.from_numpy(inputs)[None], begins, known)
        return found[0].numpy(), (known[0].numpy(), known[1].numpy())


class StudentModel(Student):
    """A student whose inference is a network of PyTorch; the others as Student."""

    def __init__(
        self,
        inference: nn.Sequential,
        teacher: Predictor,
        normalisation: Normalisation | None,
        observed: int = layout.SIZE,
    ) -> None:
        super().__init__(self._inferred, teacher, normalisation, observed)
        self.inference = inference

    def _inferred(self, observation: Floats) -> Floats:
        with torch.no_grad():
            found: Floats = self.inference(torch.from_numpy(observation)).numpy()
        return found


def weights(inference: nn.Module) -> bytes:
    """The parameters of an inference network as an npz file."""
    values = {
        name + ("_l0" if name.startswith(MEMORY) else ""): value.numpy()
        for name, value in inference.state_dict().items()
    }
    return to_npz({"format": np.array(INFERENCE_FORMAT), **values})
