"""Feedback linearization with dynamic extension for the torque-driven tracked vehicle.

Output: point D on the vehicle's axis, d ahead of the centre of mass, S (30). With h the heading,
e = (cos h, sin h), n its left normal, w the yaw rate, v_1 the forward speed, xi the compensator
and sigma = v_y + d w the lateral speed of D (body axes):
    z'   = v_1 e + sigma n                                               (32a, any v_y)
    z''  = (xi - w sigma) e + v_1 w n                                    (32b)
    z''' = (eta_1 - v_1 w^2 - sigma u_2) e + (v_1 u_2 + 2 xi w - w^2 sigma) n      (32c)
    r    = z_d''' + k_a (z_d'' - z'') + k_v (z_d' - z') + k_p (z_d - z)  (35)
    xi'  = eta_1 = r_e + v_1 w^2 + sigma u_2,   u_1 = xi                 (34)
    u_2  = (r_n - 2 xi w + w^2 sigma) / v_1                              (34)
The demand is the path point plus the arm along the heading that the vehicle must have there,
    z_d = p + d e(psi + delta),   sin(delta) = -v_y / v,
so that the centre of mass, not D, runs on the path. Torques from u_1, u_2: S (29), corrected.
Derivations, choices and limits: docs/controller.md. S is written with sigma = 0.

Assumptions: parameters of the nominal model are right; v_y and sigma are those of a steady turn
along the reference (the measured v_y is noisier than it is informative); motor lag ignored.
Validity: |v_1| > MINIMUM_SPEED; slower, the steering demand fades out.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 6.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env import observation as layout
from tracked_env.physics import terramechanics as soil
from tracked_env.physics import torque_plant as plant
from tracked_env.physics.elementary import saturated_sign, signed
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import (
    PARAMETER_INDEX,
    PARAMETER_NAMES,
    RANGES,
    PlantParameters,
)

MINIMUM_SPEED = 0.1  # [m/s] below it 1 / v_1 fades to 0; three sigma of a 0.03 m/s sensor
PROBE_SPEED = 1e-3  # [m/s] lateral speed at which the slope of the friction at rest is taken
MAXIMUM_SIDE_SLIP = 0.5  # [-] |sin(delta)| is bounded here: 30 deg, the vehicle drifts
SIDE_SLIP_ITERATIONS = 3  # [-] three leave 1e-4 of v_y; the friction is almost linear in v_y
CLOSURES = ("sliding", "constrained")

_I = layout.INDEX
_ERROR_X, _ERROR_Y = _I["position_error_x"], _I["position_error_y"]
_HEADING_ERROR, _V_X, _YAW_RATE = _I["heading_error"], _I["v_x"], _I["yaw_rate"]
_SPEED, _ACCELERATION = _I["reference_speed"], _I["reference_acceleration"]
_JERK, _TURN = _I["reference_jerk"], _I["reference_yaw_rate"]
_TURN_ACCELERATION = _I["reference_yaw_acceleration"]
_SCALE = layout.SCALE


class Gains(NamedTuple):
    """Gains of (35) and Table 3 of S; the error obeys s^3 + k_a s^2 + k_v s + k_p = 0."""

    k_p: float = 50.0  # [1/s^3]
    k_v: float = 70.0  # [1/s^2]
    k_a: float = 15.0  # [1/s]

    def poles(self) -> NDArray[np.complex128]:
        """Poles [1/s] of the error dynamics, shape (3,), slowest first."""
        roots = np.roots([1.0, self.k_a, self.k_v, self.k_p]).astype(np.complex128)
        return roots[np.argsort(-roots.real)]


class Reference(NamedTuple):
    """Motion of the path point: signed speed along the heading, and the heading's rates."""

    speed: float  # [m/s] v
    acceleration: float  # [m/s^2] dv/dt
    jerk: float  # [m/s^3] d2v/dt2
    yaw_rate: float  # [rad/s] w
    yaw_acceleration: float  # [rad/s^2] dw/dt


class Demand(NamedTuple):
    """Demanded motion of D relative to the vehicle, in measured body axes."""

    error_x: float  # [m] z_d - z
    error_y: float  # [m]
    velocity_x: float  # [m/s] z_d'
    velocity_y: float  # [m/s]
    acceleration_x: float  # [m/s^2] z_d''
    acceleration_y: float  # [m/s^2]
    jerk_x: float  # [m/s^3] z_d'''
    jerk_y: float  # [m/s^3]


@formula
def inverse_speed(speed):
    """1 / v [s/m], exact for |v| >= MINIMUM_SPEED, below it x (2 - x^2) / MINIMUM_SPEED with
    x = v / MINIMUM_SPEED: odd, continuously differentiable, 0 at standstill."""
    x = speed / MINIMUM_SPEED
    slow = x * (2.0 - x * x) / MINIMUM_SPEED
    return 1.0 / speed if abs(x) >= 1.0 else slow


@formula
def steady_lateral_velocity(speed, yaw_rate, k):
    """v_y [m/s] at which the soil carries a steady turn: F_y(v_y, w) = m w v, `sliding`.

    Fixed point v_y <- v_y m w v / F_y(v_y) with F_y from terramechanics. Odd in w and in v,
    0 without turn, bounded by MAXIMUM_SIDE_SLIP |v| where friction cannot carry the turn.
    """
    need = speed * yaw_rate / k.inverse_mass
    bound = MAXIMUM_SIDE_SLIP * abs(speed)
    v_y = 0.0
    for _ in range(SIDE_SLIP_ITERATIONS):
        probe = max(abs(v_y), PROBE_SPEED)
        force, _moment = soil.lateral_friction(
            probe, yaw_rate, k.friction_intensity, k.contact_length
        )
        v_y = min(max(need * probe / min(force, -1e-9), -bound), bound)
    return v_y


@formula
def demanded_motion(error_x, error_y, heading_error, ref, v_y, d, constrained):
    """Demand on D from the path point, its derivatives and the steady v_y [m/s].

    error_* [m] and heading_error [rad] as observed; d [m]. The heading to come is
    psi + delta; its rates are w + delta', w' and 0 (what is dropped: docs/controller.md).
    """
    v, a, w = ref.speed, ref.acceleration, ref.yaw_rate
    inverse = inverse_speed(v)
    sine = min(max(-v_y * inverse, -MAXIMUM_SIDE_SLIP), MAXIMUM_SIDE_SLIP)
    cosine = math.sqrt(1.0 - sine * sine)
    slip_rate = (d * ref.yaw_acceleration - sine * a) * inverse / cosine
    rate = w + (slip_rate if constrained else 0.0)
    c, s = math.cos(heading_error), math.sin(heading_error)
    arm_c, arm_s = d * (c * cosine - s * sine), d * (s * cosine + c * sine)
    along = ref.jerk - v * w * w
    across = 2.0 * a * w + v * ref.yaw_acceleration
    square, bend = rate * rate, ref.yaw_acceleration
    twist = 3.0 * rate * bend
    return Demand(
        error_x + arm_c - d,
        error_y + arm_s,
        v * c - rate * arm_s,
        v * s + rate * arm_c,
        a * c - v * w * s - bend * arm_s - square * arm_c,
        a * s + v * w * c + bend * arm_c - square * arm_s,
        along * c - across * s + rate * square * arm_s - twist * arm_c,
        along * s + across * c - rate * square * arm_c - twist * arm_s,
    )


@formula
def linearizing_inputs(demand, v_x, yaw_rate, sigma, xi, gains):
    """(eta_1 [m/s^3], u_2 [rad/s^2]) from (34) and (35), sigma [m/s], xi [m/s^2]."""
    r_x = (
        demand.jerk_x
        + gains.k_a * (demand.acceleration_x - (xi - yaw_rate * sigma))
        + gains.k_v * (demand.velocity_x - v_x)
        + gains.k_p * demand.error_x
    )
    r_y = (
        demand.jerk_y
        + gains.k_a * (demand.acceleration_y - v_x * yaw_rate)
        + gains.k_v * (demand.velocity_y - sigma)
        + gains.k_p * demand.error_y
    )
    turn = yaw_rate * (yaw_rate * sigma - 2.0 * xi)
    u_2 = (r_y + turn) * inverse_speed(v_x)
    return r_x + v_x * yaw_rate * yaw_rate + sigma * u_2, u_2


@formula
def against_resistance(net, speed, magnitude, inverse_width):
    """Load F with F - terramechanics.resisting(speed, F, ...) = net: its exact inverse.

    net, magnitude [N or N m], speed [m/s or rad/s]. Odd in (net, speed). At standstill the
    load jumps by 2 magnitude at net = 0, where it is 0: held friction is overcome at once.
    """
    s = saturated_sign(speed, inverse_width)
    side = s if s != 0.0 else net
    share = abs(s)
    n = signed(net, side)
    slow = max(n / max(share, 1e-300), n - 2.0 * magnitude * (1.0 - share))
    load = magnitude + (n if n >= 0.0 else slow)
    return signed(load, side) if side != 0.0 else 0.0


@formula
def turning_moment(motion, u_2, p, k, constrained):
    """Moment [N m] the tracks must give for the yaw acceleration u_2 [rad/s^2]."""
    if not constrained:
        _force, moment = soil.lateral_friction(
            motion.v_y, motion.yaw_rate, k.friction_intensity, k.contact_length
        )
        return p.inertia * u_2 - k.turning_resistance_factor * moment
    d = k.icr_forward
    none = plant.TractionLimits(0.0, 0.0, 0.0, 0.0)
    loads = plant.constrained_loads(motion, 0.0, 0.0, k, none)
    turning = plant.Motion(0.0, 0.0, 2.0 * soil.YAW_FRICTION_REGULARISATION)
    magnitude = -plant.constrained_loads(turning, 0.0, 0.0, k, none).turning_moment
    inertial = u_2 / k.inverse_inertia - d * motion.yaw_rate * motion.v_x / k.inverse_mass
    inverse_width = 1.0 / soil.YAW_FRICTION_REGULARISATION
    return against_resistance(
        inertial + d * loads.lateral_force, motion.yaw_rate, magnitude, inverse_width
    )


@formula
def track_efforts(motion, u_1, u_2, p, k, constrained):
    """Tractive efforts (left, right) [N] for u_1 [m/s^2] and u_2: S (29), corrected."""
    force = (u_1 - motion.yaw_rate * motion.v_y) / k.inverse_mass
    turn = 0.5 * turning_moment(motion, u_2, p, k, constrained) / k.half_gauge
    left, right = plant.track_speeds(motion, k.half_gauge)
    inverse_width = 1.0 / soil.MOTION_RESISTANCE_REGULARISATION
    return (
        against_resistance(0.5 * force - turn, left, k.resistance, inverse_width),
        against_resistance(0.5 * force + turn, right, k.resistance, inverse_width),
    )


@formula
def within_limit(left, right, limit):
    """Efforts (left, right) within +-limit [N]: the sum is kept first, then the difference.

    In this order a large steering demand cannot take the speed away on which steering rests.
    """
    mean = min(max(0.5 * (left + right), -limit), limit)
    room = limit - abs(mean)
    turn = min(max(0.5 * (right - left), -room), room)
    return mean - turn, mean + turn


@formula
def _parameters_of(parameters, i):
    """PlantParameters of vehicle i from (PARAMETER_ROWS, N)."""
    p = parameters[:, i]
    return PlantParameters(
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7],
        p[8], p[9], p[10], p[11], p[12], p[13], p[14], p[15],
    )  # fmt: skip


@formula
def _si(observation, i, column):
    """SI value of one entry of the observation."""
    return observation[i, column] * _SCALE[column]


@formula
def control(observation, i, p, xi, gains, period, constrained):
    """(action left, action right [-], next xi [m/s^2]) of vehicle i with parameters p."""
    k = plant.coefficients(p, constrained)
    ref = Reference(
        _si(observation, i, _SPEED),
        _si(observation, i, _ACCELERATION),
        _si(observation, i, _JERK),
        _si(observation, i, _TURN),
        _si(observation, i, _TURN_ACCELERATION),
    )
    d, v_x, yaw_rate = p.icr_forward, _si(observation, i, _V_X), _si(observation, i, _YAW_RATE)
    lateral = -d * ref.yaw_rate
    if not constrained:
        lateral = steady_lateral_velocity(ref.speed, ref.yaw_rate, k)
    sigma = lateral + d * ref.yaw_rate
    demand = demanded_motion(
        _si(observation, i, _ERROR_X),
        _si(observation, i, _ERROR_Y),
        _si(observation, i, _HEADING_ERROR),
        ref, lateral, d, constrained,
    )  # fmt: skip
    eta_1, u_2 = linearizing_inputs(demand, v_x, yaw_rate, sigma, xi, gains)
    xi += period * eta_1
    motion = plant.Motion(v_x, -d * yaw_rate if constrained else lateral, yaw_rate)
    left, right = track_efforts(motion, xi, u_2, p, k, constrained)
    limit = min(p.torque_limit * k.inverse_radius, plant.drive_limits(p).effort_limit)
    given_left, given_right = within_limit(left, right, limit)
    # Anti-windup: xi is the acceleration that the limited efforts give.
    xi += (given_left + given_right - left - right) * k.inverse_mass
    unit = p.sprocket_radius / p.torque_limit
    return given_left * unit, given_right * unit, xi


@loop
def control_all(observation, parameters, xi, gains, period, constrained, action):
    """Control of all vehicles: observation (N, D), parameters (rows, N or 1), xi (N,) in and
    out, action (N, 2) out. Returns the first row that is not finite, or -1."""
    shared = parameters.shape[1] == 1
    for i in range(observation.shape[0]):
        check = 0.0
        for column in range(observation.shape[1]):
            check += observation[i, column] * 0.0
        if check != 0.0:
            return i
        p = _parameters_of(parameters, 0 if shared else i)
        left, right, xi[i] = control(observation, i, p, xi[i], gains, period, constrained)
        action[i, 0] = min(max(left, -1.0), 1.0)
        action[i, 1] = min(max(right, -1.0), 1.0)
    return -1


def _checked(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """A parameter as float64, shape () or (N,), inside its physical range."""
    array = np.asarray(value, dtype=np.float64)
    if name not in RANGES:
        raise ValueError(f"unknown parameter {name!r}; known are {PARAMETER_NAMES}")
    if array.ndim > 1:
        raise ValueError(f"{name} has shape {array.shape}; must be a number or shape (N,)")
    low, high, unit, hint = RANGES[name]
    inside = (array >= low) & (array <= high)  # NaN is outside
    if not inside.all():
        worst = float(array[~inside][0]) if array.ndim else float(array)
        raise ValueError(
            f"nominal {name} = {worst:g} {unit}; must be in [{low:g}, {high:g}] {unit}. {hint}"
        )
    return array


class FeedbackLinearizingController:
    """Policy that tracks the reference with the corrected law of S section 6.

    parameters: nominal PlantParameters, each a number (all vehicles alike) or shape (N,).
    control_period: time [s] between two calls of `predict`.
    gains: of (35); must be positive with k_a k_v > k_p (Hurwitz).
    lateral: closure of the nominal model, "sliding" or "constrained".

    The attribute `parameters`, float64 (PARAMETER_ROWS, 1 or N), rows as PARAMETER_NAMES, is
    what the law uses at the next call: write to it, or use `set_parameters` which checks.
    Raises ValueError for gains, parameters, period or closure that make no sense.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        gains: Gains | None = None,
        lateral: str = "sliding",
    ) -> None:
        gains = Gains() if gains is None else gains
        self.gains = Gains(*(float(gain) for gain in gains))
        if not all(0.0 < gain < math.inf for gain in self.gains):
            raise ValueError(f"{self.gains}: all gains must be positive and finite")
        k_p, k_v, k_a = self.gains
        if k_a * k_v <= k_p:
            raise ValueError(
                f"{self.gains}: k_a k_v = {k_a * k_v:g} must exceed k_p = {k_p:g}, or the "
                "tracking error grows (not Hurwitz). Did you change the order of the gains?"
            )
        if not 0.0 < control_period <= 1.0:
            raise ValueError(
                f"control_period = {control_period} s; must be in (0, 1] s. Did you pass a rate?"
            )
        if lateral not in CLOSURES:
            raise ValueError(f"lateral = {lateral!r}; must be one of {CLOSURES}")
        self.control_period = float(control_period)
        self.lateral = lateral
        self._constrained = lateral == "constrained"
        self.parameters = np.empty((len(PARAMETER_NAMES), 1))
        self.set_parameters(**parameters._asdict())

    def set_parameters(self, **values: ArrayLike) -> None:
        """Change nominal parameters by name; each a number or shape (N,).

        The first array of shape (N,) fixes the number of vehicles. Raises ValueError for an
        unknown name, a value outside its physical range, or lengths that disagree.
        """
        checked = {name: _checked(name, value) for name, value in values.items()}
        lengths = {array.shape[0] for array in checked.values() if array.ndim}
        columns = self.parameters.shape[1]
        count = (lengths | {columns}) - {1}
        if len(count) > 1:
            raise ValueError(
                f"parameters for {sorted(count)} vehicles; all must have one and the same length"
            )
        if count and columns == 1:
            self.parameters = np.repeat(self.parameters, count.pop(), axis=1)
        for name, array in checked.items():
            self.parameters[PARAMETER_INDEX[name]] = array

    def predict(
        self,
        observation: NDArray[np.float32],
        state: NDArray[np.float64] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Sprocket torques over their limit, and the state to pass to the next call.

        observation: (SIZE,) or (N, SIZE) as in tracked_env.observation. state: xi [m/s^2],
        (N,), N = 1 for one vehicle; None starts at 0. episode_start: (N,) or a bool; those
        rows start at 0. deterministic: without effect, the law has no randomness.
        Returns action float32, (2,) or (N, 2), in [-1, 1], left then right; and the new xi.
        Raises ValueError for a wrong shape or an observation that is not finite.
        """
        single = np.ndim(observation) == 1
        batch = np.ascontiguousarray(observation, dtype=np.float32)
        if single:
            batch = batch.reshape(1, -1)
        count = batch.shape[0]
        if batch.ndim != 2 or batch.shape[1] != layout.SIZE:
            raise ValueError(
                f"observation has shape {np.shape(observation)}; must be ({layout.SIZE},) or "
                f"(N, {layout.SIZE}). Did a wrapper stack or append to it?"
            )
        if self.parameters.shape[1] not in (1, count):
            raise ValueError(
                f"{count} observations but parameters of {self.parameters.shape[1]} vehicles"
            )
        xi = np.zeros(count) if state is None else np.array(state, dtype=np.float64).reshape(-1)
        if xi.shape[0] != count:
            raise ValueError(f"state of {xi.shape[0]} vehicles for {count} observations")
        if episode_start is not None:
            xi[np.broadcast_to(np.asarray(episode_start, dtype=bool), (count,))] = 0.0
        action = np.empty((count, 2), dtype=np.float32)
        bad = control_all(
            batch, self.parameters, xi, self.gains, self.control_period, self._constrained, action
        )
        if bad >= 0:
            column = int(np.argmin(np.isfinite(batch[bad])))
            raise ValueError(
                f"observation[{bad}]: {layout.NAMES[column]} = {batch[bad, column]}; must be "
                "finite. Did the state diverge, or a wrapper divide by zero?"
            )
        return (action[0] if single else action), xi
