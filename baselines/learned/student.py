"""A student: infers what its teacher would see, then drives as the teacher does.

    inputs = inference(observation, past samples)       (N, F), for what the teacher's network sees
    action = teacher(observation, inputs)               of `privileged_inputs`
It sees what any agent with a history sees, and no truth. Where the teacher's inputs are normalised
and clipped, the inference is of the normalised and clipped values.

A student that remembers: it infers the true motion too, then drives as its teacher does.

    h = LSTM(x_1 ... x_t),  y = MLP([h, x])       x: observation, features, data sheet
    motion = what the features say + y_m s        true pose error, v_x, v_y and yaw rate
    action = teacher(observation with that motion and a pose of age 0, y_p)
y_p is what the teacher's network sees of `privileged_inputs`. A teacher that has learned with
`ideal` sensors then sees what it knows: noise, delays and outages are the student's to bridge. The
features are dead reckoning, or the estimates of the identification stack. What an untrained student
infers is the motion that they say, and the nominal vehicle.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.learned.agent_archive import INFERENCE, from_npz
from baselines.learned.agent_policy import (
    LSTM,
    MOTION,
    PRIVILEGED,
    STUDENT_FEATURES,
    Carried,
    Normalisation,
    Perceptron,
    Predictor,
    Shapes,
    check_weights,
    linear_shapes,
    lstm_shapes,
)
from baselines.learned.augmentation import FILTERED, RECKONED, REMEMBERED, SHEET
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


Bools = NDArray[np.bool_]
Inference = Callable[[Floats, Any, Bools], tuple[Floats, Any]]

LAYERS, MEMORY = "layers.", "lstm."  # prefixes of the weights in the archive
OUTPUTS = len(PRIVILEGED) + len(MOTION)
_SCALES = np.array([layout.SCALE[layout.INDEX[name]] for name in MOTION])
_SPREAD = (np.array(list(MOTION.values())) / _SCALES).astype(np.float32)
_BOUND = layout.BOUND[[layout.INDEX[name] for name in MOTION]]

# By features, of each of MOTION: the fields that say it, and how often [SI]. The yaw rate beside
# dead reckoning is the gyro's; what is not named is 0.
_SAID_BY: dict[str, dict[str, dict[str, float]]] = {
    "reckoned": {
        "position_error_x": {"reckoned_error_x": 1.0},
        "position_error_y": {"reckoned_error_y": 1.0},
        "heading_error": {"reckoned_heading_error": 1.0},
        "v_x": {"belt_speed": 1.0},
        "yaw_rate": {"yaw_rate": 1.0},
    },
    "estimates": {
        "position_error_x": {"filtered_error_x": 1.0},
        "position_error_y": {"filtered_error_y": 1.0},
        "heading_error": {"filtered_heading_error": 1.0},
        "v_x": {"reference_speed": 1.0, "filtered_speed_error": -1.0},
        "v_y": {"filtered_v_y": 1.0},
        "yaw_rate": {"reference_yaw_rate": 1.0, "filtered_yaw_rate_error": -1.0},
    },
}
_FEATURES = {"reckoned": RECKONED, "estimates": FILTERED}  # the first of each, and their scales


class RecurrentStudent:
    """Inference and teacher as one network, for observations widened by features.

    inference: from those (N, D), what it carries and the rows that start, to its outputs (N, F) and
    what it carries on. teacher: network that sees observation and privileged inputs.
    normalisation: of both. names: fields of the observation. features: "reckoned" or "estimates".
    Raises ValueError where one of MOTION, or a field that says one, is not among the names.
    """

    def __init__(
        self, inference: Inference, teacher: Predictor, normalisation: Normalisation | None,
        names: Sequence[str] = layout.NAMES, features: str = "reckoned",
    ) -> None:  # fmt: skip
        self.infer, self.teacher, self.normalisation = inference, teacher, normalisation
        self.observed = len(names)
        self.found: Any = None  # outputs of the inference in the last call
        said, scales = _SAID_BY[features], _FEATURES[features]
        read = dict.fromkeys(
            [*MOTION, *(name for of in said.values() for name in of if name not in scales)]
        )
        missing = [name for name in read if name not in names]
        if missing:
            raise ValueError(
                f"a student with an LSTM infers or reads {', '.join(missing)}, which the "
                "observation does not show. Add the groups pose_error, motion and reference"
            )
        self._motion = np.array([names.index(name) for name in MOTION])
        self._age = [names.index(name) for name in ("pose_age",) if name in names]
        place = {name: k for k, name in enumerate((*names, *scales))}
        scale = {name: float(layout.SCALE[layout.INDEX[name]]) for name in read} | scales
        # MOTION is a sum of two columns of the observation, each times a factor.
        self._from = np.zeros((2, len(MOTION)), int)
        self._factor = np.zeros((2, len(MOTION)), np.float32)
        for column, (name, shown_as_1) in enumerate(zip(MOTION, _SCALES, strict=True)):
            for row, (field, times) in enumerate(said.get(name, {}).items()):
                self._from[row, column] = place[field]
                self._factor[row, column] = times * scale[field] / shown_as_1

    def _said(self, observation: Floats) -> Floats:
        """MOTION as the features say it and the observation shows it (N, 6)."""
        first, second = self._from
        said: Floats = observation[:, first] * self._factor[0]
        said += observation[:, second] * self._factor[1]
        return said

    def wanted(self, observation: Floats, motion: Floats, truth: Floats) -> Floats:
        """The right outputs of the inference (N, F).

        observation: widened. motion (N, 6): the true MOTION, as an ideal observation shows it.
        truth (N, P): PRIVILEGED.
        """
        seen = scaled_by(self.normalisation, truth, slice(self.observed, None))
        return np.concatenate([seen, (motion - self._said(observation)) / _SPREAD], axis=1)

    def predict(
        self, observation: Floats, state: Any = None, episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Action (N, 2), and what inference and teacher carry on."""
        start = np.full(len(observation), state is None)
        if episode_start is not None:
            start |= np.asarray(episode_start, dtype=bool)
        carried, of_teacher = (None, None) if state is None else state
        self.found, carried = found, carried = self.infer(observation, carried, start)
        present = observation[:, : self.observed].copy()
        motion = self._said(observation) + found[:, len(PRIVILEGED) :] * _SPREAD
        present[:, self._motion] = np.clip(motion, -_BOUND, _BOUND)
        present[:, self._age] = 0.0
        shown = scaled_by(self.normalisation, present, slice(self.observed))
        widened = np.concatenate([shown, found[:, : len(PRIVILEGED)]], axis=1, dtype=np.float32)
        action, of_teacher = self.teacher.predict(widened, of_teacher, start, deterministic)
        return action, (carried, of_teacher)


def recurrent_shapes(inputs: int, hidden: Sequence[int], lstm_hidden: int) -> Shapes:
    """The weights of an inference of so many inputs, by name."""
    names = [f"{LAYERS}{name}" for name in inference_layers(hidden)]
    shapes = linear_shapes(names, (inputs + lstm_hidden, *hidden, OUTPUTS))
    return shapes | lstm_shapes(MEMORY, inputs, lstm_hidden)


class RecurrentInference:
    """The inference of an archive, in NumPy."""

    def __init__(self, weights: Mapping[str, NDArray[Any]], hidden: Sequence[int]) -> None:
        own = {n.removeprefix(MEMORY): w for n, w in weights.items() if n.startswith(MEMORY)}
        self._lstm = LSTM(own)
        names = [f"{LAYERS}{name}" for name in inference_layers(hidden)]
        self._layers = Perceptron(weights, names, "elu")

    def __call__(
        self, inputs: Floats, carried: Carried | None, start: Bools
    ) -> tuple[Floats, Carried]:
        """Outputs (N, F) and what the LSTM carries on; rows with `start` forget."""
        carried = self._lstm(inputs, self._lstm.started(carried, start))
        return self._layers(np.concatenate([carried[0], inputs], axis=1)), carried


def read_recurrent_student(
    content: bytes, options: Mapping[str, Any], inputs: int, teacher: Predictor,
    scaling: Normalisation | None, names: Sequence[str],
) -> RecurrentStudent:  # fmt: skip
    """The student in the file INFERENCE of an archive.

    options: `hidden`, `lstm_hidden` and, where they are not the usual ones, `features`. inputs:
    fields and features that it sees. Raises ValueError for weights that are damaged, not finite, or
    not those of the options.
    """
    stored = from_npz(content, INFERENCE)
    if stored.pop("format", np.array(1)).tolist() != INFERENCE_FORMAT:
        raise ValueError(f"{INFERENCE} must be of format {INFERENCE_FORMAT}. Train it again")
    check_weights(stored, recurrent_shapes(inputs, options["hidden"], options["lstm_hidden"]))
    inference = RecurrentInference(stored, options["hidden"])
    return RecurrentStudent(inference, teacher, scaling, names, features_of(options))
