"""The adaptive policy: the feedback-linearizing controller fed by the identification stack.

Certainty equivalence: at every control step the controller uses the estimates as if they were true,
    mass, mu_l, inertia, mu_t     always: without information from the data they stay constant
    gains and lag of the drives   where the observation shows the commands that were sent; commands
                                  lead a lag that is longer than the nominal one
    F_max, K                      where the data determine the traction limit, else nominal
The filtered motion stands in the observation in place of what the sensors measured. Pose errors
are those of the filtered pose to the same reference; the yaw rate is the gyro while its sample is
new and the filter has not refused it. What the controller does not use is 0 where it is missing.

`IntegralPolicy` is the same policy with the nominal parameters; integral action removes the
constant part of the error. Those that are handed the truth are in `oracle_policy`.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 7 and 8.3.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.batch_policy import Array, Bools, Floats, LearningPolicy, State, shows_attitude
from baselines.estimators import measurement
from baselines.estimators.actuators import COMMANDS, LEAST_DECAY
from baselines.estimators.stack import Identification, IdentificationStack, Memories
from baselines.linearizing import linearizing_law as law
from baselines.linearizing import linearizing_policy
from baselines.linearizing.linearizing_law import TUNED_GAINS, Gains
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.physics.lumped import drive_limits, torque_decay
from tracked_env.physics.parameters import PARAMETER_INDEX as _ROW
from tracked_env.physics.parameters import PlantParameters, plant_parameters, row_parameters

_MASS, _RESISTANCE = _ROW["mass"], _ROW["longitudinal_resistance"]
_INERTIA, _FRICTION = _ROW["inertia"], _ROW["lateral_resistance"]
_COHESION, _ANGLE = _ROW["cohesion"], _ROW["friction_angle"]
_MODULUS, _LAG = _ROW["shear_deformation_modulus"], _ROW["drive_time_constant"]
_GAIN_LEFT, _GAIN_RIGHT = _ROW["actuator_gain_left"], _ROW["actuator_gain_right"]

_I, _SIZE = layout.INDEX, layout.SIZE
_X, _Y, _YAW = _I["position_error_x"], _I["position_error_y"], _I["heading_error"]
_V_X, _V_Y, _W = _I["v_x"], _I["v_y"], _I["yaw_rate"]
_GYRO, _REJECTED = measurement.COLUMN["yaw_rate"], int(measurement.Status.REJECTED)
WILD_GYRO = 1.0  # [rad/s] from the yaw rate of the belts: a refused gyro beyond that is not used
# Sensor fields that the controller does not use, but whose NaN would stop it.
_UNUSED = np.array(
    [_I[name] for name in layout.NAMES if name.startswith(("acc", "yaw_acc", "sprocket", "torque"))]
)
LED_LAG = 0.1  # [s] drives that are nominally slower are led, too, as far as to this lag
INTEGRAL_GAINS = Gains(200.0, 120.0, 20.0, 0.5, 100.0)  # tuned, docs/tuning.md
INTEGRAL_TUNABLE = {**law.TUNABLE, "k_i": (5.0, 500.0, True)}


class AdaptiveState(NamedTuple):
    """State of the policy between two calls."""

    controller: Array  # state of the controller, (N, STATE) of the linearizing one
    memories: Memories  # of the estimators
    delivered: Array  # (N, 2) [-] what the drives give, see `lead_all`


@formula
def _put(observation, i, column, value, always):
    """Write an SI value in place of what was measured: always, or where that is missing."""
    if always or not np.isfinite(observation[i, column]):
        layout.store(observation, i, column, value)


@loop
def put_motion(observation, reference, motion, latest, answer, stale, filtered):
    """Put the filtered motion (N, 6) into observation (N, >= SIZE), in one frame with reference
    (N, 3); not filtered: only where NaN. A missing attitude counts as level.

    latest: values and age of the latest samples; stale [s]: an older gyro is not used. answer (N,):
    the slip observer's.
    """
    values, age = latest
    for i in range(observation.shape[0]):
        c, s = rotation(motion[i, 2])
        e_x, e_y = reference[i, 0] - motion[i, 0], reference[i, 1] - motion[i, 1]
        yaw_rate, gyro = motion[i, 5], values[i, _GYRO]
        wild = abs(gyro - yaw_rate) > WILD_GYRO
        outlier = answer[i].status == _REJECTED and np.isfinite(answer[i].nis) and wild
        if np.isfinite(gyro) and not (age[i, measurement.INERTIAL] > stale or outlier):
            yaw_rate = gyro
        _put(observation, i, _X, c * e_x + s * e_y, filtered)
        _put(observation, i, _Y, c * e_y - s * e_x, filtered)
        _put(observation, i, _YAW, wrap_angle(reference[i, 2] - motion[i, 2]), filtered)
        _put(observation, i, _V_X, motion[i, 3], filtered)
        _put(observation, i, _V_Y, motion[i, 4], filtered)
        _put(observation, i, _W, yaw_rate, filtered)
        for k in range(_UNUSED.shape[0]):
            _put(observation, i, _UNUSED[k], 0.0, False)
        for column in range(_SIZE, observation.shape[1]):
            if not np.isfinite(observation[i, column]):
                observation[i, column] = 0.0


@loop
def use_estimates(parameters, answers, determined, nominal, base, period):
    """Estimates into the controller's parameters (PARAMETER_ROWS, N).

    answers: (N,) each, of 1/m, mu_l, of I, mu_t, of the drives, and of the soil's F_max, K, used
    where determined (N,), and else nominal (PARAMETER_ROWS,). base [m^2] of a track. period [s] of
    the control.
    """
    longitudinal, turning, actuators, ground = answers
    for i in range(parameters.shape[1]):
        along, across = longitudinal[i].value, turning[i].value
        parameters[_MASS, i] = 1.0 / along[0]
        parameters[_RESISTANCE, i] = along[1]
        parameters[_INERTIA, i], parameters[_FRICTION, i] = across[0], across[1]
        drives, soil = actuators[i].value, ground[i].value
        parameters[_GAIN_LEFT, i] = drives[1]
        parameters[_GAIN_RIGHT, i] = drives[2]
        parameters[_LAG, i] = -period / math.log(drives[0])
        # F_max as cohesion alone: the controller needs no more than the product.
        parameters[_COHESION, i] = soil[0] / base if determined[i] else nominal[_COHESION]
        parameters[_ANGLE, i] = 0.0 if determined[i] else nominal[_ANGLE]
        parameters[_MODULUS, i] = soil[1] if determined[i] else nominal[_MODULUS]


@loop
def ground_of(parameters, soil, friction):
    """F_max, K (N, 2) and mu_t (N,) of parameters (PARAMETER_ROWS, N)."""
    for i in range(parameters.shape[1]):
        p = row_parameters(parameters.T, i, 0)
        soil[i, 0] = drive_limits(p).effort_maximum
        soil[i, 1] = p.shear_deformation_modulus
        friction[i] = p.lateral_resistance


class FilteredPolicy(LearningPolicy[State]):
    """A controller on the filtered motion; a subclass adapts it.

    parameters: nominal ones. control_period [s]: between two calls. data_sheet: noise of the
    sensors (default `rtk`). lateral: model of the nominal vehicle. gains: of the controller.
    filtered: whether the controller sees the filtered motion; None = unless the data sheet has no
    noise at all. observation: names of the fields that the environment shows.
    Raises ValueError for arguments that make no sense, and for an observation that lacks a field.
    """

    filter: Any  # of the motion, `count` vehicles
    needs: tuple[str, ...] = linearizing_policy.NEEDS  # fields, besides those of the filter

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: measurement.DataSheet | None = None,
        lateral: str = "sliding",
        gains: Gains | None = None,
        filtered: bool | None = None,
        observation: Sequence[str] = layout.NAMES,
    ) -> None:
        self.parameters = plant_parameters() if parameters is None else parameters
        self.data_sheet = measurement.DataSheet() if data_sheet is None else data_sheet
        self.sloped = shows_attitude(observation)
        # Without the commands that were sent nothing can be said of the drives.
        self._commanded = all(name in observation for name in COMMANDS)
        self.controller: Any = self._make_controller(control_period, gains, lateral, self.sloped)
        noisy = max(self.data_sheet[:3]) > 0.0
        self.filtered = noisy if filtered is None else bool(filtered)
        self._last: Any = None  # the state that the filter is in
        self._build(1)
        needs = dict.fromkeys((*self.needs, *self.filter.needs))
        self._view = layout.View(observation, tuple(needs))

    @property
    def observer(self) -> Any:
        """The filter or the identification stack, whose `update` each call of `predict` runs."""
        return self.filter

    def _make_controller(
        self, control_period: float, settings: Any, lateral: str, sloped: bool
    ) -> linearizing_policy.FeedbackLinearizingController:
        """The controller that is adapted; another policy may have another one."""
        gains = TUNED_GAINS.for_vehicle(self.parameters) if settings is None else settings
        fields = (*layout.NAMES, *measurement.ATTITUDE) if sloped else layout.NAMES
        return linearizing_policy.FeedbackLinearizingController(
            self.parameters, control_period, gains, lateral, fields
        )

    def _build(self, count: int) -> None:
        """Filter and controller of `count` vehicles, at their nominal values."""
        law = self.controller
        self.filter = self._make_filter(count, law.control_period, law.lateral)
        self._nominal = np.array(self.parameters, dtype=np.float64)
        law.parameters = np.repeat(self._nominal[:, None], count, axis=1)
        self._frozen = None
        self._put_motion, self._use_estimates = BoundOnce(put_motion), BoundOnce(use_estimates)

    def _make_filter(self, count: int, period: float, lateral: str) -> Any:
        """The filter of `count` vehicles."""
        raise NotImplementedError

    def _resume(self, count: int, state: Any) -> None:
        """Bring the filter into a state of `count` vehicles, None for a start.

        Until the call has ended well, the filter is in no known state.
        """
        if count != self.filter.count:
            self._last = None
            self._build(count)
        if state is not None and state is not self._last:
            self.filter.restore(state.memories)
        self._last = None

    def _show(
        self, observation: Floats, latest: Any, reference: Any, motion: Any, answer: Any
    ) -> None:
        """Put the filtered motion into observation, see `put_motion`."""
        samples, stale = (latest.values, latest.age), 0.5 * self.controller.control_period
        self._put_motion(observation, reference, motion, samples, answer, stale, self.filtered)


class AdaptivePolicy(FilteredPolicy[AdaptiveState]):
    """Controller and estimators as one policy, for one vehicle or a batch.

    Arguments as FilteredPolicy; gains: TUNED_GAINS by default. uses_soil: whether the estimated
    traction limits are used. S does not. slip: "batched" or "filterpy", see the stack.
    """

    stack_kind: type[IdentificationStack] = IdentificationStack
    filter: IdentificationStack

    def __init__(
        self, *arguments: Any, uses_soil: bool = True, slip: str = "batched", **options: Any
    ) -> None:
        self.uses_soil, self._slip = bool(uses_soil), slip
        # (PARAMETER_ROWS, N or 1) or None: parameters to control with instead of the estimates, NaN
        # where the estimate is used all the same.
        self.fixed_parameters: Array | None = None
        # Pose of the reference (N, 3), pose and velocities (N, 6), in place of the filtered motion.
        self.true_motion: tuple[Array, Array] | None = None
        self.identification: Identification | None = None  # of the last call
        self._make_corrector: Callable[..., Any] | None = None
        super().__init__(*arguments, **options)

    @property
    def stack(self) -> IdentificationStack:
        """The estimators."""
        return self.filter

    def _make_filter(self, count: int, period: float, lateral: str) -> IdentificationStack:
        options: dict[str, Any] = {"attitude": self.sloped, "lateral": lateral, "slip": self._slip}
        options["further"] = ("actuators",) if self._commanded else ()
        return self.stack_kind(self.parameters, period, self.data_sheet, count, **options)

    def _build(self, count: int) -> None:
        """Estimators and parameters of `count` vehicles, all at their nominal values."""
        super()._build(count)
        p = self.parameters
        self._base = float(p.track_width * p.contact_length)
        self._undetermined = np.zeros(count, dtype=bool)
        decay = torque_decay(self.controller.control_period, self._nominal[_LAG])
        self._nominal_drives = measurement.empty_rows(count, measurement.answer_row(3))
        gains = p.actuator_gain_left, p.actuator_gain_right
        self._nominal_drives["value"] = max(decay, LEAST_DECAY), *gains

        self.corrector: Any = None
        if self._make_corrector is not None and self.filtered:
            setting = p, self.controller.control_period, self.data_sheet, count
            self.corrector = self._make_corrector(*setting)
            self.stack.hold_state_of(self.corrector)

    def correct_motion(self, make: Callable[..., Any]) -> None:
        """Let an observer correct the filtered motion before the controller sees it.

        make: from nominal vehicle, control period [s], data sheet and number of vehicles, as
        `baselines.learned.learned_observer.LearnedObserver`. Its state is part of the stack's.
        """
        self._make_corrector, self._last = make, None
        self._build(self.stack.count)

    def _learned(self) -> tuple[Array, ...]:
        return (self.controller.parameters.T,)

    def act(
        self, observation: Floats, state: AdaptiveState | None, start: Bools
    ) -> tuple[Floats, AdaptiveState]:
        """Sprocket torques over their limit, and the new state; a NaN of a sensor is skipped.

        Rows that start do so from the nominal parameters.
        """
        count = len(observation)
        self._resume(count, state)
        self._use_ground(count)
        step = self.stack.update(observation, start)
        self._adapt(step)
        self._hold_frozen(start)
        reading, answer = step.reading, step.parts.answers["slip"]
        self._show(observation, reading.latest, reading.reference, step.motion_rows, answer)
        if self.corrector is not None:
            drives = step.parts.answers.get("actuators", self._nominal_drives)
            self.corrector.correct(observation, step, drives)
        memory = None if state is None else state.controller
        delivered = np.zeros((count, 2)) if state is None else state.delivered.copy()
        action, memory = self._drive(observation, start, memory, delivered)
        self.identification = step
        self._last = AdaptiveState(memory, self.stack.memories(), delivered)
        return action, self._last

    def _show(
        self, observation: Floats, latest: Any, reference: Any, motion: Any, answer: Any
    ) -> None:
        if self.true_motion is None:
            super()._show(observation, latest, reference, motion, answer)
            return
        unseen = np.full_like(latest.values, np.nan), latest.age  # no gyro is better than the truth
        self._put_motion(observation, *self.true_motion, unseen, answer, 0.0, True)

    def _drive(
        self, observation: Floats, start: Bools, memory: Any, delivered: Array
    ) -> tuple[Floats, Any]:
        """Actions of the controller and its memory; delivered (N, 2) in and out."""
        controller = self.controller
        action, memory = controller.act(observation, memory, start)
        if self._commanded:
            lag, period = min(self._nominal[_LAG], LED_LAG), controller.control_period
            linearizing_policy.lead_all(
                observation, start, controller.parameters, lag, period, delivered, action
            )
        return action, memory

    def compile_kernels(self) -> None:
        """Compile most of what `predict` calls, the last first, see `stack.compile_kernels`."""
        self._build(1)
        fields = self._view(np.zeros(self._view.size, dtype=np.float32))
        self._drive(fields, np.ones(1, dtype=bool), None, np.zeros((1, 2)))
        self.stack.compile_kernels()
        self._build(1)
        self._last = None

    def _use_ground(self, count: int) -> None:
        """Let the filter take the ground of fixed parameters for certain, if all are fixed."""
        fixed = self.fixed_parameters
        if fixed is not None and not np.isnan(fixed).any():
            parameters = np.repeat(fixed, count, axis=1) if fixed.shape[1] == 1 else fixed
            soil, friction = np.empty((count, 2)), np.empty(count)
            ground_of(parameters, soil, friction)
            self.stack.slip.take_ground(soil, np.zeros((count, 2, 2)), friction)

    def _adapt(self, step: Identification) -> None:
        """Pass the estimates to the controller, or the parameters fixed in their place."""
        fixed, controller, answers = self.fixed_parameters, self.controller, step.parts.answers
        if fixed is not None and not np.isnan(fixed).any():
            controller.parameters = fixed
            return
        drives = answers.get("actuators", self._nominal_drives)
        rows = answers["longitudinal"], answers["turning"], drives, answers["soil"]
        determined = step.traction_determined if self.uses_soil else self._undetermined
        nominal, period = self._nominal, controller.control_period
        self._use_estimates(controller.parameters, rows, determined, nominal, self._base, period)
        if fixed is not None:
            estimate = controller.parameters
            controller.parameters = np.where(np.isnan(fixed), estimate, fixed)

    def estimates(self) -> Mapping[str, tuple[Array, Array]]:
        """(value, standard deviation) by name after the last call, each (N,), SI."""
        return {} if self.identification is None else self.identification.estimates()

    def excited(self) -> Mapping[str, Bools]:
        """Whether the data determine the parameter, by name, (N,)."""
        if self.identification is None:
            return {}
        return {
            quantity: status == measurement.Status.CONVERGING
            for name, status in self.identification.status().items()
            for quantity in self.identification.provided[name]
        }

    def nis(self) -> Mapping[str, Array]:
        """Normalised innovation squared of each estimator in the last call, (N,)."""
        return {} if self.identification is None else self.identification.nis()


class FixedParametersPolicy:
    """An adaptive policy, made of the same arguments, with parameters that it does not identify;
    it therefore shows no estimates."""

    identifying: type[AdaptivePolicy] = AdaptivePolicy

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._policy = self.identifying(*arguments, **options)

    @property
    def controller(self) -> Any:
        """The controller that drives."""
        return self._policy.controller

    @property
    def observer(self) -> Any:
        """The identification stack, whose `update` each call of `predict` runs."""
        return self._policy.observer

    def predict(self, *arguments: Any, **options: Any) -> tuple[Floats, AdaptiveState]:
        """As AdaptivePolicy.predict."""
        return self._policy.predict(*arguments, **options)


class IntegralPolicy(FixedParametersPolicy):
    """Nominal parameters, the filter of the adaptive policy, integral action with anti-windup.

    Arguments as AdaptivePolicy; gains: INTEGRAL_GAINS by default.
    """

    def __init__(self, *arguments: Any, gains: Gains = INTEGRAL_GAINS, **options: Any) -> None:
        super().__init__(*arguments, gains=gains, **options)
        nominal = np.array(self._policy.parameters, dtype=np.float64)
        self._policy.fixed_parameters = nominal[:, np.newaxis]
