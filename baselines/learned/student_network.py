"""A student: infers what its teacher would see, then drives as the teacher does.

    inputs = inference(observation, past samples)       (N, F), for what the teacher's network sees
    action = teacher(observation, inputs)               of `privileged_inputs`
It sees what any agent with a history sees, and no truth. Where the teacher's inputs are normalised
and clipped, the inference is of the normalised and clipped values.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.learned.agent_archive import INFERENCE, from_npz
from baselines.learned.agent_policy import Normalisation, Predictor
from baselines.learned.forward_pass import Perceptron, check_weights, linear_shapes
from baselines.learned.history_augmentation import REMEMBERED
from baselines.learned.privileged_inputs import PRIVILEGED, STUDENT_FEATURES
from baselines.learned.reckoned_augmentation import SHEET
from tracked_env import observation as layout

Floats = NDArray[np.float32]

INFERENCE_FORMAT = 2  # of its file; 1, without it, inferred values before their normalisation


def scaled_by(normalisation: Normalisation | None, values: Floats, columns: slice) -> Floats:
    """What the teacher's network sees of some of its columns."""
    if normalisation is None:
        return values
    mean, variance, *rest = normalisation
    return Normalisation(mean[columns], variance[columns], *rest)(values)


def features_of(options: Mapping[str, Any], drive: str = "torque") -> str:
    """What a student with an LSTM sees besides the observation: a kind of augmentation.

    Raises ValueError for estimates of a vehicle that is driven by its sprocket speeds: these do not
    say the whole motion.
    """
    features = str(options.get("features", STUDENT_FEATURES[0]))
    if features == "estimates" and drive != "torque":
        raise ValueError(
            f"features = {features} of a student on a vehicle driven by its sprocket {drive}; must "
            "be reckoned: the estimates there have no speeds. Leave --student.features out"
        )
    return features


def widened_by(options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Kind and options of the observation augmentation of a student with these options."""
    sheet = {"data_sheet": True} if options.get("data_sheet", False) else {}
    if "lstm_hidden" in options:
        return features_of(options), sheet
    return "history", {"lags": tuple(options["lags"]), **sheet}


class Student:
    """Inference and teacher as one network, for observations widened by a history.

    inference: from those (N, D) to what the teacher's network sees of the privileged inputs (N, F).
    teacher: network that sees observation and privileged inputs. normalisation: of those.
    observed: number of fields of the observation.
    """

    def __init__(
        self,
        inference: Callable[[Floats], Floats],
        teacher: Predictor,
        normalisation: Normalisation | None,
        observed: int = layout.SIZE,
    ) -> None:
        self.infer, self.teacher, self.normalisation = inference, teacher, normalisation
        self.observed = observed

    def privileged(self, truth: Floats) -> Floats:
        """What the teacher's network sees of the privileged inputs (N, F): the right inference."""
        return scaled_by(self.normalisation, truth, slice(self.observed, None))

    def predict(
        self, observation: Floats, state: Any = None, episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Action (N, 2) and the state of a recurrent teacher."""
        present = scaled_by(
            self.normalisation, observation[:, : self.observed], slice(self.observed)
        )
        widened = np.concatenate([present, self.infer(observation)], axis=1, dtype=np.float32)
        return self.teacher.predict(widened, state, episode_start, deterministic)


def inference_sizes(
    lags: Sequence[int], hidden: Sequence[int], observed: int = layout.SIZE, sheet: bool = False
) -> tuple[int, ...]:
    """Inputs, hidden layers and outputs of an inference network; sheet: sees the data sheet."""
    further = len(SHEET) if sheet else 0
    return (observed + len(lags) * len(REMEMBERED) + further, *hidden, len(PRIVILEGED))


def inference_layers(hidden: Sequence[int]) -> list[str]:
    """Names of its layers, as torch.nn.Sequential counts them; ELUs stand between."""
    return [str(2 * number) for number in range(len(hidden) + 1)]


def read_student(
    content: bytes, options: Mapping[str, Any], teacher: Predictor,
    scaling: Normalisation | None, observed: int = layout.SIZE,
) -> Student:  # fmt: skip
    """The student in the file INFERENCE of an archive. options: `lags` and `hidden`.

    Raises ValueError for weights that are damaged, not finite, or not those of the options.
    """
    stored = from_npz(content, INFERENCE)
    written = stored.pop("format", np.array(1)).tolist()
    if written != INFERENCE_FORMAT and (written != 1 or scaling is not None):
        raise ValueError(
            f"{INFERENCE} holds an inference of format {written}; must be {INFERENCE_FORMAT}: what "
            "it infers has another scale. Train the student again"
        )
    names = inference_layers(options["hidden"])
    sheet = options.get("data_sheet", False)
    sizes = inference_sizes(options["lags"], options["hidden"], observed, sheet)
    shapes = linear_shapes(names, sizes)
    check_weights(stored, shapes)
    return Student(Perceptron(stored, names, "elu"), teacher, scaling, observed)
