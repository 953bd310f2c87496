"""A learned observer: a recurrent network that corrects the filtered motion of a controller.

It stands between the identification stack and a controller that is fed by it (`adaptive`,
`mpc-adaptive`). Both stay what they are; the controller sees
    shown + min(max(y, -LIMIT), LIMIT) u        of MOTION: pose error, v_x, v_y and yaw rate
with [y, s] the outputs of a gated network for x, the FEATURES, u the filter's own standard
deviations of the pose and SPEED_UNITS of the speeds, and exp(s) u the standard deviation of what is
then shown. The features are the observation with the filtered motion in it, what the
stack has identified and how well, the data sheet of the sensors, and what does not agree:
    innovations     fresh samples less the filtered motion of their time, in body axes, over their
                    noise; a late pose is compared with the motion that was filtered then
    kinematics      rates of the filtered motion less accelerometers and gyro; by how much the
                    filtered pose moved beyond the filtered speeds, over `u`
    slower filters  the error that filters with the time constants SLOWER find in the filtered pose:
                    e' = e - jump + a (innovation - e), a = t / (t + tau), t since the last sample
"""

import math
from typing import Any, NamedTuple

import numpy as np

from baselines.batch_policy import Array, Floats
from baselines.estimators.measurement import COLUMN, INERTIAL, POSE, REJECTED, DataSheet, Stateful
from baselines.estimators.stack import Identification
from baselines.learned.agent_policy import Arrays
from baselines.learned.gated_network import Layers, RecurrentNetwork, layers_of
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import PlantParameters

MOTION = ("position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate")
LIMIT = 2.0  # [-] of a correction, in units of `u`
SPEED_UNITS = (0.02, 0.02, 0.005)  # [m/s, m/s, rad/s] of v_x, v_y and yaw rate
# [m, rad] of a pose that is known for certain, and of one that the filter has let go because
# samples contradict it: for a few steps it claims 0.3 rad, by which no heading should move.
LEAST_UNITS, LARGEST_UNITS = (1e-3, 5e-4), (2.0, 0.05)
UNITS_AS_ZERO = (0.01, 0.005)  # [m, rad] `u` whose logarithm is shown as 0
BOUND = 10.0  # [-] features are clipped to
OLDEST_POSE = 1.0  # [s] an older sample is not compared with the motion of its time
SPREADS = (-7.0, 5.0)  # [-] bounds of s

# What the data sheet says, and what is shown as 0 [SI]; logarithms.
SHEET = {
    "position_noise": 0.02, "yaw_noise": 0.005, "velocity_noise": 0.03, "acceleration_noise": 0.05,
    "acceleration_bias": 0.02, "gyro_noise": 0.002, "gyro_bias": 0.001,
    "sprocket_speed_noise": 0.02, "torque_noise": 10.0,
}  # fmt: skip
DISAGREEMENTS = (
    "innovation_x", "innovation_y", "innovation_yaw", "innovation_v_x", "innovation_v_y",
    "innovation_yaw_rate", "unfelt_acceleration_x", "unfelt_acceleration_y", "unfelt_yaw_rate",
    "jump_x", "jump_y", "jump_yaw",
    *(f"slower_{name}_{k}" for k in range(3) for name in ("x", "y", "yaw")),
)  # fmt: skip
FEATURES = (
    *layout.NAMES,
    *("belts_less_v_x", "belts_less_yaw_rate", "gyro_less_yaw_rate"),
    *("slip_left", "slip_right", "side_slip"),
    *("position_log_deviation", "yaw_log_deviation"),
    *("slip_left_log_deviation", "slip_right_log_deviation"),
    *DISAGREEMENTS,
    *("pose_is_new", "inertial_is_new", "drive_is_new", "pose_is_refused", "nis"),
    *("log_mass", "longitudinal_resistance", "log_inertia", "lateral_resistance"),
    *("actuator_gain_left", "actuator_gain_right", "drive_time_constant"),
    *("log_traction_limit", "log_modulus"),
    *("mass_deviation", "longitudinal_resistance_deviation", "inertia_deviation"),
    *("lateral_resistance_deviation", "gain_left_deviation", "gain_right_deviation"),
    *(f"sheet_{name}" for name in (*SHEET, "pose_delay")),
)
SLOWER = (0.5, 2.0, 8.0)  # [s]
STATE_SIZE = 6  # numbers of a motion in the ring
NOTES = 3  # rows of the ring behind the motions: control step and last sample, then errors

_SHOWN = np.array([layout.INDEX[name] for name in MOTION])
_SCALES, _SIZE = layout.SCALE[_SHOWN], layout.SIZE
_SCALE_X, _SCALE_YAW, _SCALE_W = _SCALES[0], _SCALES[2], _SCALES[5]
_FINER = 4.0  # [-] pose errors are shown this much larger than in the observation
_GYRO, _V_X = COLUMN["yaw_rate"], COLUMN["v_x"]
_A_X, _A_Y = COLUMN["acceleration_x"], COLUMN["acceleration_y"]
_SPROCKET = COLUMN["sprocket_speed_left"]
_YAW_RATE = layout.INDEX["yaw_rate"]


class Constants(NamedTuple):
    """What the kernels read of vehicle and sensors."""

    period: float  # [s]
    radius: float  # [m] of the sprockets
    gauge: float  # [m]
    mass: float  # [kg] nominal, and so on
    inertia: float
    traction: float  # [N] F_max
    modulus: float  # [m]
    noise: Array  # (6,) of x, y, yaw, v_x, v_y and gyro
    sheet: Array  # (SHEET + 1,) as it is shown

    @classmethod
    def of(cls, p: PlantParameters, period: float, sheet: DataSheet) -> "Constants":
        """Of a nominal vehicle and its sensors."""
        xy, v = sheet.position_noise, sheet.velocity_noise
        noise = np.maximum([xy, xy, sheet.yaw_noise, v, v, sheet.gyro_noise], 1e-4)
        values = np.array([getattr(sheet, name) for name in SHEET]) / np.array([*SHEET.values()])
        shown = np.clip(np.log10(np.maximum(values, 1e-3)), -3.0, 3.0)
        return cls(
            float(period), float(p.sprocket_radius), float(p.track_gauge), float(p.mass),
            float(p.inertia), float(drive_limits(p).effort_maximum),
            float(p.shear_deformation_modulus), noise, np.append(shown, 5.0 * sheet.pose_delay),
        )  # fmt: skip


@formula
def _bounded(value):
    """A feature: clipped, and 0 where it is missing."""
    return min(max(value, -BOUND), BOUND) if math.isfinite(value) else 0.0


@formula
def _slower(f, c, innovation, jump, is_new, heading, units, notes, k):
    """The errors e of the slower filters, moved on, over units into f[c:]. innovation and jump:
    x, y of the world [m] and yaw; notes (NOTES, 6) of the vehicle."""
    since = k.period * (notes[0, 0] - notes[0, 1])
    cosine, sine = rotation(heading)
    for j in range(3):
        e = notes[1 + j // 2, 3 * (j % 2) : 3 * (j % 2) + 3]
        share = since / (since + SLOWER[j]) if is_new else 0.0
        for a in range(3):
            e[a] -= jump[a]
            e[a] += share * (innovation[a] - e[a])
        f[c + 3 * j] = _bounded((cosine * e[0] + sine * e[1]) / units[0])
        f[c + 3 * j + 1] = _bounded((cosine * e[1] - sine * e[0]) / units[1])
        f[c + 3 * j + 2] = _bounded(e[2] / units[2])
    if is_new:
        notes[0, 1] = notes[0, 0]


@formula
def _agreement(f, c, values, fresh, age, motion, units, ring, k):
    """DISAGREEMENTS of one vehicle into f[c:]; motion (6,). ring (slots + NOTES, 6) has the motions
    before this one, the last of them in slot (n - 1) % slots, with n the control step."""
    slots = ring.shape[0] - NOTES
    notes = ring[slots:]
    n = int(notes[0, 0])
    e_x = e_y = e_yaw = jump_x = jump_y = jump_yaw = 0.0
    for j in range(12):
        f[c + j] = 0.0
    is_new = False
    if fresh[POSE] and math.isfinite(values[0] + values[1] + values[2]):
        older = int(age[POSE] / k.period + 0.5)
        if older <= min(n, slots):
            is_new, slot = True, (n - older) % slots
            then = motion if older == 0 else ring[slot]
            cosine, sine = rotation(then[2])
            e_x, e_y = values[0] - then[0], values[1] - then[1]
            e_yaw = wrap_angle(values[2] - then[2])
            f[c] = _bounded((cosine * e_x + sine * e_y) / k.noise[0])
            f[c + 1] = _bounded((cosine * e_y - sine * e_x) / k.noise[1])
            f[c + 2] = _bounded(e_yaw / k.noise[2])
            for a in range(3, 5):
                f[c + a] = _bounded((values[_V_X + a - 3] - then[a]) / k.noise[a])
    if fresh[INERTIAL]:
        f[c + 5] = _bounded((values[_GYRO] - motion[5]) / k.noise[5])
    if n > 0:
        last, rate = ring[(n - 1) % slots], 1.0 / k.period
        v_x, v_y, w = motion[3], motion[4], motion[5]
        f[c + 6] = _bounded(rate * (v_x - last[3]) - w * v_y - values[_A_X])
        f[c + 7] = _bounded(rate * (v_y - last[4]) + w * v_x - values[_A_Y])
        f[c + 8] = _bounded(20.0 * (rate * (motion[2] - last[2]) - values[_GYRO]))
        cosine, sine = rotation(0.5 * (motion[2] + last[2]))
        ahead, left = 0.5 * k.period * (v_x + last[3]), 0.5 * k.period * (v_y + last[4])
        jump_x = motion[0] - last[0] - (cosine * ahead - sine * left)
        jump_y = motion[1] - last[1] - (sine * ahead + cosine * left)
        jump_yaw = motion[2] - last[2] - 0.5 * k.period * (w + last[5])
        f[c + 9] = _bounded((cosine * jump_x + sine * jump_y) / units[0])
        f[c + 10] = _bounded((cosine * jump_y - sine * jump_x) / units[1])
        f[c + 11] = _bounded(jump_yaw / units[2])
    jump = jump_x, jump_y, jump_yaw
    _slower(f, c + 12, (e_x, e_y, e_yaw), jump, is_new, motion[2], units, notes, k)
    for a in range(STATE_SIZE):
        ring[n % slots, a] = motion[a]
    notes[0, 0] = n + 1.0


@formula
def _identified(f, c, answers, i, k):
    """What the stack knows of vehicle i, and its deviations, into f[c:]."""
    along, across, drives, soil = answers[1][i], answers[2][i], answers[3][i], answers[4][i]
    f[c] = _bounded(-2.0 * math.log(along.value[0] * k.mass))
    f[c + 1] = _bounded(2.0 * along.value[1])
    f[c + 2] = _bounded(2.0 * math.log(across.value[0] / k.inertia))
    f[c + 3] = _bounded(2.0 * across.value[1])
    f[c + 4] = _bounded(3.0 * (drives.value[1] - 1.0))
    f[c + 5] = _bounded(3.0 * (drives.value[2] - 1.0))
    f[c + 6] = _bounded(-10.0 * k.period / math.log(drives.value[0]))
    f[c + 7] = _bounded(math.log(soil.value[0] / k.traction))
    f[c + 8] = _bounded(math.log(soil.value[1] / k.modulus))
    f[c + 9] = _bounded(10.0 * math.sqrt(along.covariance[0, 0]) / along.value[0])
    f[c + 10] = _bounded(10.0 * math.sqrt(along.covariance[1, 1]))
    f[c + 11] = _bounded(10.0 * math.sqrt(across.covariance[0, 0]) / across.value[0])
    f[c + 12] = _bounded(10.0 * math.sqrt(across.covariance[1, 1]))
    f[c + 13] = _bounded(10.0 * math.sqrt(drives.covariance[1, 1]))
    f[c + 14] = _bounded(10.0 * math.sqrt(drives.covariance[2, 2]))


@loop
def look(observation, samples, motion, answers, ring, k, units, features):
    """Features (N, F) and units (N, 6) out; ring (N, slots + NOTES, 6) of the motions so far.

    observation (N, >= SIZE): with the filtered motion in it. samples: values, fresh and age of the
    latest ones. motion (N, 6): as it was filtered. answers: rows (N,) of slip observer,
    longitudinal, turning, actuators and soil.
    """
    values, fresh, age = samples
    for i in range(observation.shape[0]):
        f, m, slip = features[i], motion[i], answers[0][i]
        p = slip.covariance
        place, yaw = math.sqrt(0.5 * (p[0, 0] + p[1, 1])), math.sqrt(p[2, 2])
        units[i, 0] = units[i, 1] = min(max(place, LEAST_UNITS[0]), LARGEST_UNITS[0])
        units[i, 2] = min(max(yaw, LEAST_UNITS[1]), LARGEST_UNITS[1])
        for a in range(3):
            units[i, 3 + a] = SPEED_UNITS[a]
        for a in range(_SIZE):
            f[a] = _bounded(observation[i, a] * (_FINER if a < 3 else 1.0))
        left, right = k.radius * values[i, _SPROCKET], k.radius * values[i, _SPROCKET + 1]
        c = _SIZE
        f[c] = _bounded(5.0 * (0.5 * (left + right) - m[3]))
        f[c + 1] = _bounded(10.0 * ((right - left) / k.gauge - m[5]))
        f[c + 2] = _bounded(100.0 * (observation[i, _YAW_RATE] * _SCALE_W - m[5]))
        for a in range(3):
            f[c + 3 + a] = _bounded(3.0 * slip.value[3 + a])
        f[c + 6] = _bounded(0.5 * math.log(units[i, 0] / UNITS_AS_ZERO[0]))
        f[c + 7] = _bounded(0.5 * math.log(units[i, 2] / UNITS_AS_ZERO[1]))
        f[c + 8] = _bounded(0.25 * math.log(p[3, 3] / 0.01))
        f[c + 9] = _bounded(0.25 * math.log(p[4, 4] / 0.01))
        c += 10
        _agreement(f, c, values[i], fresh[i], age[i], m, units[i], ring[i], k)
        c += 21
        for g in range(3):
            f[c + g] = 1.0 if fresh[i, g] else 0.0
        f[c + 3] = 1.0 if slip.status == REJECTED else 0.0
        f[c + 4] = _bounded(math.log(1.0 + slip.nis))
        _identified(f, c + 5, answers, i, k)
        c += 20
        for a in range(k.sheet.shape[0]):
            f[c + a] = k.sheet[a]


@loop
def show(observation, outputs, units, before, shown, deviations):
    """Correct MOTION in observation (N, >= SIZE), in place. Out, (N, 6) [SI] each: what it was
    before, what is shown, and the standard deviations of that."""
    for i in range(observation.shape[0]):
        for a in range(_SHOWN.shape[0]):
            value = observation[i, _SHOWN[a]] * _SCALES[a]
            before[i, a] = value
            value += min(max(outputs[i, a], -LIMIT), LIMIT) * units[i, a]
            if a == 2:
                value = wrap_angle(value)
            layout.store(observation, i, _SHOWN[a], value)
            shown[i, a] = value
            spread = min(max(outputs[i, 6 + a], SPREADS[0]), SPREADS[1])
            deviations[i, a] = units[i, a] * math.exp(spread)


def observer_layers(weights: Arrays, recurrent: bool) -> Layers:
    """The network of an observer from its weights. Raises ValueError."""
    return layers_of(weights, len(FEATURES), 2 * len(MOTION), recurrent)


class LearnedObserver(Stateful):
    """The observer of `count` vehicles behind a stack with this nominal vehicle, control period [s]
    and data sheet.

    network: None corrects nothing. After each call `features` (N, F) and, (N, 6) each in SI,
    `units`, the motion `before`, the one `shown` and its `deviations` are there.
    """

    def __init__(
        self,
        network: RecurrentNetwork | None,
        vehicle: PlantParameters,
        control_period: float,
        sheet: DataSheet,
        count: int,
    ) -> None:
        self.network = network
        self._constants = Constants.of(vehicle, control_period, sheet)
        slots = round(OLDEST_POSE / control_period) + 1
        self.ring = np.zeros((count, (slots + NOTES) * STATE_SIZE))
        self.features = np.empty((count, len(FEATURES)), dtype=np.float32)
        self.units, self.before, self.shown, self.deviations = np.empty((4, count, len(MOTION)))
        hidden = 1 if network is None else network.size
        self.memory: Any = np.zeros((count, hidden), dtype=np.float32)
        self._infer = None if network is None else network.batch(count)
        self._silence = np.zeros((count, 2 * len(MOTION)), dtype=np.float32)
        self._look, self._show = BoundOnce(look), BoundOnce(show)

    def correct(self, observation: Floats, step: Identification, drives: Any) -> None:
        """Correct the motion in an observation (N, >= SIZE) that shows the filtered one, in place.

        step: of the stack. drives: rows (N,) of the actuators' answer.
        """
        of, latest = step.parts.answers, step.reading.latest
        answers = of["slip"], of["longitudinal"], of["turning"], drives, of["soil"]
        rings = self.ring.reshape(len(self.ring), -1, STATE_SIZE)
        samples = latest.values, latest.fresh, latest.age
        self._look(
            observation, samples, step.motion_rows, answers, rings, self._constants, self.units,
            self.features,
        )  # fmt: skip
        outputs = self._silence
        if self._infer is not None:
            outputs = self._infer(self.features, self.memory)
        after = self.before, self.shown, self.deviations
        self._show(observation, outputs, self.units, *after)
