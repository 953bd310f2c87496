"""Feedback-linearizing controller: a policy over the law of linearizing_law.

It applies the law with the nominal parameters of each vehicle, keeps the efforts within what drive
and soil give, and holds the compensator xi and the integral j of the position error as its state.
    F_limit = min(g torque limit / r, F(i = 1))          nominal, S (7), g: gain of the drive
    action  = F r / (g torque limit)
    xi+     = xi + dt eta_1 + (F_limited - F_demanded) / m      anti-windup, F over both tracks
    j+      = j + dt e   along axes in which the limits leave room for it       anti-windup
Where the observation shows ATTITUDE, the law drives in the plane that they give, with gravity
in it; where it does not, the ground counts as level.

Lead of slow drives (`lead_all`): a drive of lag T follows its command u by
h(n+1) = a h(n) + (1 - a) u with a = exp(-dt / T), where a nominal one would reach
a_0 h(n) + (1 - a_0) u_d. Both are the same for
    u = h + (u_d - h) b,    b = (1 - a_0) / (1 - a), at most LARGEST_LEAD, and 1 where T <= T_0
with h what the drive gives now, in units of the command and of its gain: a model that follows the
commands that were sent. Noise of the demand is amplified by b as well; the action stays in [-1, 1].

References: [S] Strawa et al., Electronics 10 (2021) 187, section 6.
"""

import math
from collections.abc import Sequence

import numpy as np

from baselines.batch_policy import (
    Array,
    BatchPolicy,
    Bools,
    Floats,
    check_columns,
    not_finite,
    parameter_rows,
    shows_attitude,
)
from baselines.estimators.measurement import ATTITUDE
from baselines.linearizing import linearizing_law as law
from baselines.linearizing.linearizing_law import Gains
from tracked_env import observation as layout
from tracked_env.physics import lumped as vehicle
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import signed
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.physics.parameters import PARAMETER_INDEX, PlantParameters, row_parameters
from tracked_env.physics.rigid_body import LEVEL, incline_of
from tracked_env.validation import CONTROL_PERIOD, checked_number

LATERAL_MODELS = ("sliding", "constrained")
STATE = 4  # xi [m/s^2], j [m s] along body x and y, whether steering comes first (law.turns_first)
ROUNDING = 1e-9  # [-] of the limit of an effort: a shortage below it is none
LARGEST_LEAD = 6.0  # [-] a lag of 0.3 s as fast as one of 0.05 s takes 5.1 at 50 Hz

# Fields of the observation that the law reads.
_POSE, _REFERENCE = (layout.make_layout([group]).names for group in ("pose_error", "reference"))
NEEDS = (*_POSE, "v_x", "yaw_rate", *_REFERENCE)
_ERROR_X, _ERROR_Y, _HEADING_ERROR, _V_X, _YAW_RATE = (layout.INDEX[name] for name in NEEDS[:5])
_SPEED, _ACCELERATION, _JERK, _TURN, _TURN_ACCELERATION = (layout.INDEX[n] for n in _REFERENCE)
_SCALE = layout.SCALE
_ROLL, _PITCH = layout.SIZE, layout.SIZE + 1  # ATTITUDE stands behind the fields of v0
_ROLL_SCALE, _PITCH_SCALE = layout.make_layout(["attitude"]).scale[:2]
_COMMAND = layout.INDEX["previous_action_left"]
_LAG = PARAMETER_INDEX["drive_time_constant"]


@formula
def measured_incline(observation, i, sloped):
    """Incline of vehicle i as measured, or LEVEL."""
    if not sloped:
        return LEVEL
    return incline_of(observation[i, _PITCH] * _PITCH_SCALE, observation[i, _ROLL] * _ROLL_SCALE)


@formula
def is_finite(observation, i):
    """Whether all of row i are finite numbers."""
    check = 0.0
    for column in range(observation.shape[1]):
        check += observation[i, column] * 0.0
    return check == 0.0


@formula
def _si(observation, i, column):
    """SI value of one entry of the observation."""
    return observation[i, column] * _SCALE[column]


@formula
def _shortage(demanded, limited, limit):
    """Demanded less limited effort [N]; 0 where the difference is rounding."""
    lack = demanded - limited
    return lack if abs(lack) > ROUNDING * limit else 0.0


@formula
def control(observation, i, p, lacking, memory, gains, setting):
    """(action left, action right [-]) of vehicle i with PlantParameters p.

    lacking: (forward [m/s^2], turning [rad/s^2]) that the model lacks, cancelled by the efforts.
    memory (N, STATE): row i in and out. setting: control period [s], whether the lateral model is
    the constrained one, whether ATTITUDE stands behind the fields of v0.
    """
    period, constrained, sloped = setting
    xi, integral = memory[i, 0], law.Integral(memory[i, 1], memory[i, 2])
    incline = measured_incline(observation, i, sloped)
    k = law.pressed(vehicle.coefficients(p, constrained), incline.press)
    heading_error = _si(observation, i, _HEADING_ERROR)
    # A vehicle that faces backwards follows the same path in reverse, heading psi + pi.
    faces_back = abs(heading_error) > 0.5 * math.pi
    facing = -1.0 if faces_back else 1.0
    ref = law.Reference(
        facing * _si(observation, i, _SPEED),
        facing * _si(observation, i, _ACCELERATION),
        facing * _si(observation, i, _JERK),
        _si(observation, i, _TURN),
        _si(observation, i, _TURN_ACCELERATION),
    )
    d, v_x, yaw_rate = p.icr_forward, _si(observation, i, _V_X), _si(observation, i, _YAW_RATE)
    lateral = -d * ref.yaw_rate
    if not constrained:
        pull = soil.GRAVITY * incline.down_y
        ahead = p.centre_of_mass_x
        lateral = law.steady_lateral_velocity(ref.speed, ref.yaw_rate, k, pull, ahead)
    sigma = lateral + d * ref.yaw_rate
    heading_error -= signed(math.pi, heading_error) if faces_back else 0.0
    error_x, error_y = _si(observation, i, _ERROR_X), _si(observation, i, _ERROR_Y)
    demand = law.demanded_motion(error_x, error_y, heading_error, ref, lateral, d, constrained)
    demand = law.lifted(demand, incline)
    eta_1, u_2 = law.linearizing_inputs(demand, v_x, yaw_rate, sigma, xi, gains, integral)
    xi += period * eta_1
    motion = vehicle.Motion(v_x, -d * yaw_rate if constrained else lateral, yaw_rate)
    pull = soil.GRAVITY * incline.down_x
    u_1, u_2 = xi - lacking[0], u_2 - lacking[1]
    left, right = law.track_efforts(motion, u_1, u_2, p, k, constrained, pull)
    limit = p.torque_limit * k.inverse_radius
    limit_left, limit_right = p.actuator_gain_left * limit, p.actuator_gain_right * limit
    if not sloped:
        traction = law.TRACTION * vehicle.drive_limits(p).effort_limit
        limit_left, limit_right = min(limit_left, traction), min(limit_right, traction)
    turning = memory[i, 3] = law.turns_first(memory[i, 3], v_x, heading_error, demand, gains)
    weaker = min(limit_left, limit_right)
    reserve = turning * law.turning_reserve(motion, u_2, p, k, constrained, weaker)
    most_left, most_right = law.within_limits(left, right, limit_left, limit_right, reserve)
    # Anti-windup: xi is the acceleration that the limited efforts give.
    memory[i, 0] = xi + ((most_left - left) + (most_right - right)) * k.inverse_mass
    short = _shortage(left + right, most_left + most_right, limit)
    turning_short = _shortage(right - left, most_right - most_left, limit)
    error_x, error_y = law.bounded_error(demand, gains.bound)
    integral = law.integrated(integral, error_x, error_y, short, turning_short * v_x, period)
    memory[i, 1], memory[i, 2] = integral.x, integral.y
    unit = p.sprocket_radius / p.torque_limit
    return most_left * unit / p.actuator_gain_left, most_right * unit / p.actuator_gain_right


@loop
def control_all(observation, parameters, lacking, memory, gains, setting, action):
    """Control of all vehicles: observation (N, D), parameters (rows, N or 1), lacking (N or 1, 2),
    memory (N, STATE) in and out, action (N, 2) out. Returns the first row that is not finite, or
    -1."""
    shared, alike = parameters.shape[1] == 1, lacking.shape[0] == 1
    for i in range(observation.shape[0]):
        if not is_finite(observation, i):
            return i
        p, n = row_parameters(parameters.T, 0 if shared else i, 0), 0 if alike else i
        missing = lacking[n, 0], lacking[n, 1]
        left, right = control(observation, i, p, missing, memory, gains, setting)
        action[i, 0] = min(max(left, -1.0), 1.0)
        action[i, 1] = min(max(right, -1.0), 1.0)
    return -1


@formula
def _reached(observation, i, side, start, decay, delivered):
    """What a drive gives now [-], of what it gave one period ago and the command sent since."""
    sent = observation[i, _COMMAND + side]
    reached = decay * delivered[i, side] + (1.0 - decay) * sent
    return 0.0 if start[i] else reached


@loop
def reached_all(observation, start, parameters, period, delivered):
    """Bring delivered (N, 2) to the present; arguments as `lead_all`."""
    shared = parameters.shape[1] == 1
    for i in range(delivered.shape[0]):
        decay = vehicle.torque_decay(period, parameters[_LAG, 0 if shared else i])
        for side in range(2):
            delivered[i, side] = _reached(observation, i, side, start, decay, delivered)


@loop
def lead_all(observation, start, parameters, nominal_lag, period, delivered, action):
    """Actions (N, 2) in and out; delivered (N, 2) [-] what the drives give, in and out.

    observation (N, >= SIZE); start (N,): rows that begin, at rest; parameters (PARAMETER_ROWS, N or
    1) with the lag; nominal_lag T_0 and period dt [s].
    """
    nominal = vehicle.torque_decay(period, nominal_lag)
    shared = parameters.shape[1] == 1
    for i in range(action.shape[0]):
        decay = vehicle.torque_decay(period, parameters[_LAG, 0 if shared else i])
        factor = 1.0
        if decay > nominal:
            factor = min((1.0 - nominal) / (1.0 - decay), LARGEST_LEAD)
        for side in range(2):
            now = delivered[i, side] = _reached(observation, i, side, start, decay, delivered)
            if factor > 1.0:
                action[i, side] = min(max(now + (action[i, side] - now) * factor, -1.0), 1.0)


class FeedbackLinearizingController(BatchPolicy[Array]):
    """Policy that tracks the reference with the corrected law of S section 6.

    parameters: nominal PlantParameters, each a number (all vehicles alike) or shape (N,).
    control_period: time [s] between two calls of `predict`.
    gains: of (35); must be Hurwitz. default: those that were tuned.
    lateral: lateral model of the nominal vehicle, "sliding" or "constrained".
    observation: names of the fields that the environment gives.

    The attribute `parameters`, float64 (PARAMETER_ROWS, 1 or N), rows as PARAMETER_NAMES, is
    what the law uses at the next call: write to it, or replace it by `parameter_rows`.
    `lacking`, float64 (1 or N, 2), is the acceleration [m/s^2] and the yaw acceleration [rad/s^2]
    that the vehicle has beside those of the model; the efforts cancel them. Zero unless written to.
    Raises ValueError for gains, parameters, period or lateral model that make no sense, and
    for an observation that lacks a field of NEEDS.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        gains: Gains | None = None,
        lateral: str = "sliding",
        observation: Sequence[str] = layout.NAMES,
    ) -> None:
        self.gains = law.checked_gains(Gains() if gains is None else gains)
        if lateral not in LATERAL_MODELS:
            raise ValueError(f"lateral = {lateral!r}; must be one of {LATERAL_MODELS}")
        self.sloped = shows_attitude(observation)
        self._view = layout.View(observation, (*NEEDS, *ATTITUDE) if self.sloped else NEEDS)
        self.control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        self.lateral = lateral
        self._setting = (self.control_period, lateral == "constrained", self.sloped)
        self.parameters = parameter_rows(parameters._asdict())
        self.lacking = np.zeros((1, 2))
        self._control = BoundOnce(control_all)

    def act(self, observation: Floats, state: Array | None, start: Bools) -> tuple[Floats, Array]:
        """Sprocket torques over their limit and the state (N, STATE), 0 where one starts."""
        count = len(observation)
        check_columns(count, self.parameters.shape[1])
        memory = np.zeros((count, STATE))
        if state is not None:
            memory = np.array(state, dtype=np.float64, order="C")
        self.same_count(len(memory), count)
        memory[start] = 0.0
        action = np.empty((count, 2), dtype=np.float32)
        parameters = np.ascontiguousarray(self.parameters, dtype=np.float64)
        lacking = np.ascontiguousarray(self.lacking, dtype=np.float64)
        setting = self.gains, self._setting
        bad = self._control(observation, parameters, lacking, memory, *setting, action)
        if bad >= 0:
            raise not_finite(observation, bad)
        return action, memory
