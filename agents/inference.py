"""The network of a student: infers what its teacher was told, then drives as the teacher does.

    inputs = inference(observation, past samples)       (N, F), for what the teacher's network sees
    action = teacher(observation, inputs)               of agents.privileged.privileged
It sees what any agent with memory `history` sees, and no truth. Where the teacher's inputs are
normalised and clipped, the inference is of the normalised and clipped values.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.memory import History
from agents.networks import fill, from_npz, to_npz
from agents.policy import Normalisation, Predictor
from agents.privileged import PRIVILEGED
from tracked_env import observation as layout

Floats = NDArray[np.float32]

STUDENT = "student"  # the kind of memory in a recipe
WEIGHTS = "student.npz"  # in the archive, beside the teacher's networks
FORMAT = 2  # of it; 1, without an entry `format`, inferred values before their normalisation


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

    def _shown(self, values: Floats, columns: slice) -> Floats:
        """What the teacher's network sees of some of its columns."""
        if self.normalisation is None:
            return values
        mean, variance, *rest = self.normalisation
        return Normalisation(mean[columns], variance[columns], *rest)(values)

    def told(self, truth: Floats) -> Floats:
        """What the teacher's network sees of the privileged inputs (N, F): the right inference."""
        return self._shown(truth, slice(layout.SIZE, None))

    def infer(self, observation: Floats) -> Floats:
        """What the student believes that the teacher would be told, (N, F)."""
        with torch.no_grad():
            found: Floats = self.inference(torch.from_numpy(observation)).numpy()
        return found

    def predict(
        self, observation: Floats, state: Any = None, episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Action (N, 2) and the state of a recurrent teacher."""
        present = self._shown(observation[:, : layout.SIZE], slice(layout.SIZE))
        widened = np.concatenate([present, self.infer(observation)], axis=1, dtype=np.float32)
        return self.teacher.predict(widened, state, episode_start, deterministic)


def weights(inference: nn.Sequential) -> bytes:
    """The parameters of an inference network as an npz file."""
    values = {name: value.numpy() for name, value in inference.state_dict().items()}
    return to_npz({"format": np.array(FORMAT), **values})


def load_student(
    content: bytes, options: Mapping[str, Any], teacher: Predictor, scaling: Normalisation | None
) -> StudentModel:
    """The student in the file WEIGHTS of an archive. options: `lags` and `hidden`.

    Raises ValueError for weights that are damaged, not finite, or not those of the options.
    """
    with torch.random.fork_rng(devices=[]):  # its first weights are replaced
        inference = make_inference(tuple(options["lags"]), tuple(options["hidden"]))
    expected = {name: value.numpy() for name, value in inference.state_dict().items()}
    stored = from_npz(content, WEIGHTS)
    written = stored.pop("format", np.array(1)).tolist()
    if written != FORMAT and (written != 1 or scaling is not None):
        raise ValueError(
            f"{WEIGHTS} holds an inference of format {written}; must be {FORMAT}: what it infers "
            "has another scale. Train the student again"
        )
    fill(inference, stored, expected)
    return StudentModel(inference, teacher, scaling)
