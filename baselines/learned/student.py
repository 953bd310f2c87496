"""Teachers and students: the hidden parameters as inputs, from the truth or inferred.

A teacher sees the hidden parameters in force and the slips beside the observation; as a policy it
declares `needs_truth`, like the oracle. A student infers these inputs from what any agent with a
history sees, then drives with the same network:
    inputs = inference(observation, past samples)       (N, F), for what the teacher's network sees
    action = teacher(observation, inputs)
Where the teacher's inputs are normalised and clipped, the inference is of these values.

A student that remembers infers the true motion too:
    h = LSTM(x_1 ... x_t),  y = MLP([h, x])       x: observation, features, data sheet
    motion = what the features say + y_m s        true pose error, v_x, v_y and yaw rate
    action = teacher(observation with that motion and a pose of age 0, y_p)
y_p is what the teacher's network sees of PRIVILEGED. A teacher that has learned with `ideal`
sensors then sees what it knows: noise, delays and outages are the student's to bridge. The features
are dead reckoning, or the estimates of the identification stack.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from baselines.batch_policy import Array, Context, body_errors
from baselines.learned.agent_policy import (
    TEACHER,
    V0_GROUPS,
    AgentPolicy,
    Arrays,
    Groups,
    Network,
    Normalisation,
    Predictor,
    check_weights,
    network_shapes,
)
from baselines.learned.augmentation import (
    FILTERED,
    RECKONED,
    Augmentation,
    Bools,
    Floats,
)
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY, mohr_coulomb

Truth = Mapping[str, Array]
Inference = Callable[[Floats, Any, Bools], tuple[Floats, Any]]

# Logarithm of the ratio to nominal that is shown as 1, and the differences that are.
RATIOS = {"mass": 0.3, "inertia": 0.3, "shear_deformation_modulus": 0.5, "traction_limit": 1.0}
DIFFERENCES = {
    "longitudinal_resistance": 0.3, "lateral_resistance": 0.3, "drive_time_constant": 0.1,
    "slip_left": 0.5, "slip_right": 0.5,
}  # fmt: skip
PRIVILEGED = (*RATIOS, *DIFFERENCES)
# The true motion, as fields of the observation that ideal sensors would fill, and how far it is
# usually from what dead reckoning says [SI].
MOTION = {
    "position_error_x": 0.1, "position_error_y": 0.1, "heading_error": 0.05,
    "v_x": 0.1, "v_y": 0.1, "yaw_rate": 0.05,
}  # fmt: skip
_COLUMNS = [layout.INDEX[name] for name in MOTION]
_SCALES, MOTION_BOUND = layout.SCALE[_COLUMNS], layout.BOUND[_COLUMNS]
MOTION_SPREAD = (np.array(list(MOTION.values())) / _SCALES).astype(np.float32)


def _quantities(truth: Mapping[str, Any]) -> dict[str, Any]:
    """The truth and the largest effort F_max of one track [N], Mohr-Coulomb."""
    area, load = truth["track_width"] * truth["contact_length"], 0.5 * GRAVITY * truth["mass"]
    limit = mohr_coulomb(truth["cohesion"], np.tan(truth["friction_angle"]), area, load)
    return {**truth, "traction_limit": limit}


def true_motion(truth: Truth, reference: Sequence[Array]) -> Floats:
    """MOTION (N, 6) of the true state, as the observation shows it.

    reference: x, y [m] and yaw [rad] of the reference now, (N,) each.
    """
    errors = body_errors(reference, truth["x"], truth["y"], truth["yaw"])
    values = np.stack([*errors, truth["v_x"], truth["v_y"], truth["yaw_rate"]], axis=1)
    bound = MOTION_BOUND.astype(np.float64)
    return np.clip(values / _SCALES, -bound, bound).astype(np.float32)


def privileged(truth: Truth, nominal: PlantParameters) -> Floats:
    """The true PRIVILEGED quantities over their scales, (N, F), finite and clipped, 0 = nominal.

    Slips are clipped to 1 before they are scaled, everything to FEATURE_BOUND after.
    """
    values = _quantities(truth)
    usual = {"slip_left": 0.0, "slip_right": 0.0, **_quantities(nominal._asdict())}
    with np.errstate(divide="ignore"):  # a soil without any traction is shown as the bound
        columns = [np.log(values[name] / usual[name]) / scale for name, scale in RATIOS.items()]
    for name, scale in DIFFERENCES.items():
        value = np.clip(values[name], -1.0, 1.0) if name.startswith("slip") else values[name]
        columns.append((value - usual[name]) / scale)
    shown = np.nan_to_num(np.stack(columns, axis=-1))
    return np.clip(shown, -layout.FEATURE_BOUND, layout.FEATURE_BOUND).astype(np.float32)


class Privileged(Augmentation):
    """The true hidden parameters of N vehicles, which somebody writes before each `observe`.

    `present` (N, F) belongs to the observation that is shown. `last` is the same except in rows
    that have just ended, where it belongs to the last observation of the episode.
    """

    feature_names = PRIVILEGED

    def __init__(self, count: int, control_period: float) -> None:
        super().__init__(count, control_period)
        self.present: Floats = np.zeros((0, len(PRIVILEGED)), dtype=np.float32)
        self.last = self.present

    def features(self, observation: Floats, start: Bools) -> Floats:
        """The privileged inputs (N, F). Raises ValueError where no truth has been written."""
        if len(self.present) != len(observation):
            raise ValueError(
                f"observation has shape {observation.shape}, but the truth of {len(self.present)} "
                "vehicles was observed; a teacher needs `observe_truth` before each `predict`. A "
                "student drives without."
            )
        return np.where(start[:, None], self.present, self.last)


class TeacherPolicy(AgentPolicy):
    """A teacher as a policy of the benchmark, which must be handed the truth."""

    needs_truth = True

    def __init__(
        self,
        model: Predictor,
        context: Context,
        normalisation: Normalisation | None = None,
        groups: Groups = V0_GROUPS,
    ) -> None:
        self.nominal, self._truth = context.vehicle, Privileged(1, context.control_period)
        super().__init__(model, TEACHER, {}, context, normalisation, groups)

    def _augmentation(self, count: int) -> Augmentation:
        self._truth.count = count
        return self._truth

    def observe_truth(self, truth: Truth) -> None:
        """Take over the truth, {name: number or (N,)}; other names are ignored."""
        values = {name: np.atleast_1d(value) for name, value in truth.items() if name[0] != "_"}
        self._truth.present = self._truth.last = privileged(values, self.nominal)


def policy_of(
    model: Predictor,
    kind: str,
    options: Mapping[str, Any],
    context: Context,
    normalisation: Normalisation | None = None,
    groups: Groups = V0_GROUPS,
) -> AgentPolicy:
    """A model as the policy that its kind makes of it; arguments as AgentPolicy."""
    if kind == TEACHER:
        return TeacherPolicy(model, context, normalisation, groups)
    return AgentPolicy(model, kind, options, context, normalisation, groups)


# Students

INFERENCE = "student.npz"  # in an archive
INFERENCE_FORMAT = 2  # of that file
LAYERS, MEMORY = "layers.", "lstm."  # prefixes of the weights of an inference with an LSTM


def widened_by(options: Mapping[str, Any], drive: str = "torque") -> tuple[str, dict[str, Any]]:
    """Kind and options of the observation augmentation of a student with these options.

    Raises ValueError for estimates of a vehicle that is driven by its sprocket speeds: these do not
    say the whole motion.
    """
    sheet = {"data_sheet": True} if options.get("data_sheet", False) else {}
    if "lstm_hidden" not in options:
        return "history", {"lags": tuple(options["lags"]), **sheet}
    features = options.get("features", STUDENT_FEATURES[0])
    if features == "estimates" and drive != "torque":
        raise ValueError(
            f"features = {features} of a student on a vehicle driven by its sprocket {drive}; must "
            "be reckoned: the estimates there have no speeds. Leave --student.features out"
        )
    return features, sheet


# By features, of each of MOTION: the fields that say it, and how often [SI]. The yaw rate beside
# dead reckoning is the gyro's; what is not named is 0.
_SOURCES: dict[str, dict[str, dict[str, float]]] = {
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
STUDENT_FEATURES = tuple(_SOURCES)  # of a student with an LSTM, first the usual one
_FEATURES = {"reckoned": RECKONED, "estimates": FILTERED}  # the first of each, and their scales


class MotionByFeatures:
    """MOTION in an observation with these fields, as the features behind it say it.

    features: "reckoned" or "estimates". Raises ValueError where one of MOTION, or a field that says
    one, is not among the names.
    """

    def __init__(self, names: Sequence[str], features: str) -> None:
        sources, scales = _SOURCES[features], _FEATURES[features]
        read = dict.fromkeys(
            [*MOTION, *(name for of in sources.values() for name in of if name not in scales)]
        )
        missing = [name for name in read if name not in names]
        if missing:
            raise ValueError(
                f"a student with an LSTM infers or reads {', '.join(missing)}, which the "
                "observation does not show. Add the groups pose_error, motion and reference"
            )
        self.columns = np.array([names.index(name) for name in MOTION])
        self.age = [names.index(name) for name in ("pose_age",) if name in names]
        place = {name: k for k, name in enumerate((*names, *scales))}
        scale = {name: float(layout.SCALE[layout.INDEX[name]]) for name in read} | scales
        # A sum of two columns of the observation, each times a factor.
        self.sources = np.zeros((2, len(MOTION)), int)
        self.factors = np.zeros((2, len(MOTION)), np.float32)
        for column, (name, shown_as_1) in enumerate(zip(MOTION, _SCALES, strict=True)):
            for row, (field, times) in enumerate(sources.get(name, {}).items()):
                self.sources[row, column] = place[field]
                self.factors[row, column] = times * scale[field] / shown_as_1

    def __call__(self, observation: Floats) -> Floats:
        """MOTION (N, 6) in the scales of the observation, which is widened by the features."""
        first, second = self.sources
        motion: Floats = observation[:, first] * self.factors[0]
        motion += observation[:, second] * self.factors[1]
        return motion


class Student:
    """Inference and teacher as one network, for observations widened by an augmentation.

    infer: from those (N, D), what it carries and the rows that start, to its outputs (N, F) and
    what it carries on. teacher: network that sees observation and privileged inputs.
    normalisation: of both. names: fields of the observation. kind: of the augmentation; where it is
    no history, the outputs are the motion too. Raises ValueError as MotionByFeatures.
    """

    def __init__(
        self,
        infer: Inference,
        teacher: Predictor,
        normalisation: Normalisation | None,
        names: Sequence[str] = layout.NAMES,
        kind: str = "history",
    ) -> None:
        self.infer, self.teacher, self.normalisation = infer, teacher, normalisation
        self.observed = len(names)
        self.motion = None if kind == "history" else MotionByFeatures(names, kind)
        self.inferred: Any = None  # outputs of the inference in the last call

    def _scaled(self, values: Floats, columns: slice) -> Floats:
        """What the teacher's network sees of some of its inputs."""
        return values if self.normalisation is None else self.normalisation.of(columns)(values)

    def right(self, observation: Floats, motion: Any, truth: Floats) -> Floats:
        """The right outputs of the inference (N, F).

        observation: widened. motion (N, 6): the true MOTION, as an ideal observation shows it, of a
        student that infers it. truth (N, P): PRIVILEGED.
        """
        inputs = self._scaled(truth, slice(self.observed, None))
        if self.motion is None:
            return inputs
        return np.concatenate([inputs, (motion - self.motion(observation)) / MOTION_SPREAD], axis=1)

    def predict(
        self,
        observation: Floats,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Action (N, 2), and what inference and teacher carry on."""
        start = np.full(len(observation), state is None)
        if episode_start is not None:
            start |= np.asarray(episode_start, dtype=bool)
        carried, of_teacher = (None, None) if state is None else state
        self.inferred, carried = inferred, carried = self.infer(observation, carried, start)
        present = observation[:, : self.observed]
        if self.motion is not None:
            present = present.copy()
            motion = self.motion(observation) + inferred[:, len(PRIVILEGED) :] * MOTION_SPREAD
            present[:, self.motion.columns] = np.clip(motion, -MOTION_BOUND, MOTION_BOUND)
            present[:, self.motion.age] = 0.0
        shown = self._scaled(present, slice(self.observed))
        inputs = np.concatenate([shown, inferred[:, : len(PRIVILEGED)]], axis=1, dtype=np.float32)
        action, of_teacher = self.teacher.predict(inputs, of_teacher, start, deterministic)
        return action, (carried, of_teacher)


def read_student(
    weights: Arrays,
    options: Mapping[str, Any],
    inputs: int,
    teacher: Predictor,
    scaling: Normalisation | None,
    names: Sequence[str],
) -> Student:
    """The student with the arrays of INFERENCE in an archive.

    options: `hidden`, and `lags` or `lstm_hidden` and `features`. inputs: fields and features that
    it sees. Raises ValueError for weights that are not finite, or not those of the options.
    """
    written = weights.pop("format", np.array(1)).tolist()
    if written != INFERENCE_FORMAT:
        raise ValueError(
            f"{INFERENCE} is of format {written}; must be {INFERENCE_FORMAT}. Train it again"
        )
    hidden, carried = options["hidden"], options.get("lstm_hidden", 0)
    layers = [f"{LAYERS if carried else ''}{2 * number}" for number in range(len(hidden) + 1)]
    outputs = len(PRIVILEGED) + (len(MOTION) if carried else 0)
    shapes = network_shapes(layers, (inputs, *hidden, outputs), MEMORY, carried)
    check_weights(weights, shapes)
    infer = Network(weights, layers, "elu", MEMORY if carried else None)
    return Student(infer, teacher, scaling, names, widened_by(options)[0])
