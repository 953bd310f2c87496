"""The network of a student while it learns: in PyTorch, beside the network of its teacher."""

from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.networks import to_npz
from baselines.learned.agent_policy import Normalisation, Predictor
from baselines.learned.student_network import INFERENCE_FORMAT, Student, inference_sizes
from tracked_env import observation as layout

Floats = NDArray[np.float32]


def make_inference(
    lags: tuple[int, ...], hidden: tuple[int, ...], observed: int = layout.SIZE
) -> nn.Sequential:
    """An untrained network from observation and history to the privileged inputs.

    It begins by saying 0, nominal: its last layer is zero. observed: number of fields of the
    observation.
    """
    sizes = inference_sizes(lags, hidden, observed)
    parts: list[nn.Module] = []
    for size, following in pairwise(sizes[:-1]):
        parts += [nn.Linear(size, following), nn.ELU()]
    last = nn.Linear(sizes[-2], sizes[-1])
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*parts, last)


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


def weights(inference: nn.Sequential) -> bytes:
    """The parameters of an inference network as an npz file."""
    values = {name: value.numpy() for name, value in inference.state_dict().items()}
    return to_npz({"format": np.array(INFERENCE_FORMAT), **values})
