"""The network of a student: infers what its teacher was told, then drives as the teacher does.

    inputs = inference(observation, past samples)       (N, F), for agents.privileged.privileged
    action = teacher(observation, inputs)
It sees what any agent with memory `history` sees, and no truth.
"""

import io
import zipfile
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.memory import History
from agents.policy import Normalisation, Predictor
from agents.privileged import PRIVILEGED
from tracked_env import observation as layout

Floats = NDArray[np.float32]

STUDENT = "student"  # the kind of memory in a recipe
WEIGHTS = "student.npz"  # in the archive, beside the teacher's networks


def make_inference(lags: tuple[int, ...], hidden: tuple[int, ...]) -> nn.Sequential:
    """An untrained network from observation and history to the privileged inputs.

    It begins by saying 0, nominal: its last layer is zero.
    """
    sizes = (layout.SIZE + len(History(1, 0.02, lags).feature_names), *hidden)
    parts: list[nn.Module] = []
    for size, following in pairwise(sizes):
        parts += [nn.Linear(size, following), nn.ELU()]
    last = nn.Linear(sizes[-1], len(PRIVILEGED))
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*parts, last)


class StudentModel:
    """Inference and teacher as one predictor, for observations widened by a history.

    teacher: model that sees observation and privileged inputs. normalisation: of those.
    """

    def __init__(
        self, inference: nn.Sequential, teacher: Predictor, normalisation: Normalisation | None
    ) -> None:
        self.inference, self.teacher, self.normalisation = inference, teacher, normalisation

    def infer(self, observation: Floats) -> Floats:
        """The privileged inputs (N, F) that the student believes in."""
        with torch.no_grad():
            found: Floats = self.inference(torch.from_numpy(observation)).numpy()
        return found

    def predict(
        self, observation: Floats, state: Any = None, episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Action (N, 2) and the state of a recurrent teacher."""
        widened = np.concatenate(
            [observation[:, : layout.SIZE], self.infer(observation)], axis=1, dtype=np.float32
        )
        if self.normalisation is not None:
            widened = self.normalisation(widened)
        return self.teacher.predict(widened, state, episode_start, deterministic)


def weights(inference: nn.Sequential) -> bytes:
    """The parameters of an inference network as an npz file."""
    buffer = io.BytesIO()
    np.savez(buffer, **{name: value.numpy() for name, value in inference.state_dict().items()})
    return buffer.getvalue()


def load_student(
    path: Path, options: Mapping[str, Any], teacher: Predictor, scaling: Normalisation | None
) -> StudentModel:
    """The student in an archive. options: `lags` and `hidden`. Raises ValueError."""
    try:
        inference = make_inference(tuple(options["lags"]), tuple(options["hidden"]))
        with zipfile.ZipFile(path) as archive, np.load(io.BytesIO(archive.read(WEIGHTS))) as stored:
            inference.load_state_dict({name: torch.from_numpy(stored[name]) for name in stored})
    except (KeyError, RuntimeError, ValueError) as error:
        raise ValueError(
            f"agent {path} cannot be loaded as a student: {WEIGHTS} in it is missing, or is not "
            f"what its recipe says ({error})"
        ) from error
    return StudentModel(inference, teacher, scaling)
