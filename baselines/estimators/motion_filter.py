"""The filtered motion: observation reader and slip observer, and poses that come late.

For controllers that want the pose and the velocities of the adaptive policy's filter, and not its
parameters; the identification stack begins with it. Without identification the ground of an outage
is the nominal one, as uncertain as the soil estimator assumes it before any data.

The time of the slip filter is that of the drive samples, which move it. Where the pose is late
too, its estimate is that old, and `advance` brings it to the present; where the pose is newer than
the drive, the filter has already been pulled there.

A pose that is L steps old tells of step n - L. Where slips change within the delay, no constant
slip explains both the belts now and that pose, and a filter that tries to loses the heading, on
weak soil within a second. So all samples of one moment are taken together,
    filter, regressions   at n - L, with belts, torques, gyro and accelerometer of then
    to the present        v_x' = f_x + w v_y - b,   psi' = w - b_w,   x', y' from them (trapezoids)
with f_x, w what was felt since, b, b_w the biases that pose_outages has learned, and v_y as it was.
Slips of the present are those of that motion and of the belts of now; what the accelerometer and
the gyro add to the variance of the speed, L steps long, adds to theirs.
L is of the data sheet. In the first L steps of an episode there is nothing new at the moment of
the first pose: the filter waits, and the motion is that pose and the inertial way since.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import pose_outages as outage
from baselines.estimators import slip_kinematics as kinematics
from baselines.estimators import slip_step as step
from baselines.estimators.measurement import (
    ATTITUDE,
    COLUMN,
    DRIVE,
    INERTIAL,
    POSE,
    DataSheet,
    Estimate,
    Measurement,
    Setting,
    arrays_of,
)
from baselines.estimators.observation_reader import (
    FIRST,
    GROUP_SIZE,
    NEEDS,
    ObservationReader,
    Reading,
)
from baselines.estimators.slip_kinematics import SIDE_SLIP, SLIP_LEFT, SLIP_LIMIT, SLIP_RIGHT
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.soil_estimator import PRIOR_SIGMA
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import PlantParameters, plant_parameters
from tracked_env.physics.rigid_body import heading_rate, incline_of, on_map
from tracked_env.physics.terramechanics import GRAVITY, slip_ratio

Floats = NDArray[np.float64]
Memories = tuple[Floats, ...]
_AFTER_SENSORS = layout.INDEX["reference_speed"]  # from here on: reference, action, ages
_V_X, _SPROCKET = COLUMN["v_x"], COLUMN["sprocket_speed_left"]
_A_X, _W, _BEND = (COLUMN[name] for name in ("acceleration_x", "yaw_rate", "yaw_acceleration"))
BODY_VELOCITY = slice(_V_X, _V_X + 2)
_FIRST = int(FIRST[INERTIAL])


class Moment(NamedTuple):
    """What N vehicles measured when the last pose saw them."""

    samples: Measurement  # ages as they were then
    paired: Measurement  # inertial and drive of one moment, then; not fresh where there is no pair
    drive_delay: Floats  # (N,) [s] beyond that of the pose
    steps: NDArray[np.int64]  # (N,) since then
    waits: NDArray[np.bool_]  # (N,) nothing is new: the filter waits


class FilteredMotion(NamedTuple):
    """What one observation of N vehicles says after the filter."""

    latest: Measurement  # each group's last sample
    reference: Floats  # (N, 3) pose of the reference now [m, m, rad]
    rows: Floats  # (N, 6) X, Y, psi, v_x, v_y, w, now
    answer: NDArray[Any]  # (N,) bare, of the slip observer


@loop
def inspect(observation, start):
    """(row, column, starts): the first reference, action or age of observation (N, >= SIZE) that is
    not finite, or (-1, -1), and whether any row of start (N,) is marked. Sensors may be NaN: those
    samples are skipped."""
    starts = False
    for i in range(observation.shape[0]):
        starts = starts or start[i]
        for column in range(_AFTER_SENSORS, layout.SIZE):
            if not math.isfinite(observation[i, column]):
                return i, column, starts
    return -1, -1, starts


@loop
def date(age, delay, behind):
    """Ages (N, 3) [s] of the pose become those at the time of the filter. delay (N,) [s] of the
    drive. behind (N,) [s] out: how old what the filter knows is."""
    for i in range(age.shape[0]):
        behind[i] = min(age[i, POSE], delay[i])
        age[i, POSE] -= behind[i]


@loop
def advance(motion, behind, inertial, attitude):
    """Move a motion, (N, 6), that is `behind` (N,) [s], to the present, in place. Its v_x and v_y
    take the place of those of inertial (N, CHANNELS) at that time, whose acceleration and yaw
    acceleration stay what they are; what the accelerometer feels of gravity, by the attitude
    (N, 3), moves nothing."""
    for i in range(motion.shape[0]):
        time = behind[i]
        inertial[i, _V_X], inertial[i, _V_X + 1] = motion[i, 3], motion[i, 4]
        if time > 0.0:
            yaw, v_x, v_y, yaw_rate = motion[i, 2], motion[i, 3], motion[i, 4], motion[i, 5]
            incline = incline_of(attitude[i, 1], attitude[i, 0])
            turn, carried = heading_rate(incline, attitude[i, 2])
            forward = inertial[i, _A_X] + GRAVITY * incline.down_x + yaw_rate * v_y
            bend = inertial[i, _BEND]
            gain_x = forward * time if math.isfinite(forward) else 0.0
            gain_w = bend * time if math.isfinite(bend) else 0.0
            along, across = on_map(time * (v_x + 0.5 * gain_x), time * v_y, incline)
            c, s = rotation(yaw + 0.5 * time * (turn * (yaw_rate + 0.25 * gain_w) + carried))
            motion[i, 0] += c * along - s * across
            motion[i, 1] += s * along + c * across
            motion[i, 2] += time * (turn * (yaw_rate + 0.5 * gain_w) + carried)
            motion[i, 3] += gain_x
            motion[i, 5] += gain_w


@formula
def _newest(ring, moment):
    """(slot of a ring (K,) with the last sample up to `moment`, steps it is older); -1: none."""
    slots = ring.shape[0]
    for older in range(min(slots, moment + 1)):
        slot = (moment - older) % slots
        if ring[slot].taken == moment - older + 1.0:
            return slot, older
    return -1, 0


@loop
def look_back(readers, rings, period, lag, moment):
    """Samples of `lag` steps ago out of the reader, into a Moment whose samples, pairs and delay
    are those of now; its steps and waits (N,) are written."""
    values, fresh, age = moment.samples
    pairs, pair, pair_age = moment.paired
    delay, steps, waits = moment.drive_delay, moment.steps, moment.waits
    for i in range(readers.shape[0]):
        now = int(readers[i].step) - 1
        steps[i] = min(lag, now)
        waits[i] = 0 < now <= lag
        since = steps[i] * period
        for group in (INERTIAL, DRIVE):
            slot, older = _newest(rings[i, group - 1], now - steps[i])
            fresh[i, group] = slot >= 0 and older == 0 and not waits[i]
            age[i, group] = older * period
            for c in range(GROUP_SIZE):
                taken = rings[i, group - 1, slot].values[c] if slot >= 0 else np.nan
                values[i, FIRST[group] + c] = taken
        if pair_age[i, DRIVE] < since + 0.5 * period:  # else even later than the pose
            for group in (INERTIAL, DRIVE):
                pair[i, group] = fresh[i, INERTIAL] and fresh[i, DRIVE]
                pair_age[i, group] = since
                for c in range(GROUP_SIZE):
                    pairs[i, FIRST[group] + c] = values[i, FIRST[group] + c]
        fresh[i, POSE] = fresh[i, POSE] and not waits[i]
        age[i, POSE] = max(age[i, POSE] - since, 0.0)
        delay[i] = max(delay[i] - since, 0.0)


@loop
def carry(motion, readers, rings, period, steps, filters, attitude):
    """Motion (N, 6) of `steps` (N,) ago to the present, in place, by the inertial samples since.
    readers (N,), rings (N, 2, K): of the reader; filters (N,): rows of the slip observer, with the
    biases of accelerometer and gyro; attitude (N, 3). Where a sample is missing, the accelerations
    of the one before last on."""
    for i in range(motion.shape[0]):
        now = int(readers[i].step) - 1
        bias_a, bias_w = filters[i].speed[outage.BIAS], filters[i].heading[outage.BIAS]
        incline = incline_of(attitude[i, 1], attitude[i, 0])
        turn, carried = heading_rate(incline, attitude[i, 2])
        v_y, force, turning = motion[i, 4], 0.0, motion[i, 5]
        for k in range(steps[i] + 1):
            slot, older = _newest(rings[i, INERTIAL - 1], now - steps[i] + k)
            a, w = force, turning
            if slot >= 0:
                inertial = rings[i, INERTIAL - 1, slot].values
                new_a = inertial[_A_X - _FIRST] - bias_a + GRAVITY * incline.down_x
                new_w = inertial[_W - _FIRST] - bias_w
                if older > 0 and math.isfinite(inertial[_BEND - _FIRST]):
                    new_w += older * period * inertial[_BEND - _FIRST]
                a = new_a if abs(new_a) < outage.LARGEST_ACCELERATION else force
                w = new_w if abs(new_w - motion[i, 5]) < outage.WILD_TURN else turning
            if k > 0:
                mean_w = 0.5 * (turning + w)
                gain = period * (0.5 * (force + a) + mean_w * v_y)
                bend = period * (turn * mean_w + carried)
                c, s = rotation(motion[i, 2] + 0.5 * bend)
                way = period * (motion[i, 3] + 0.5 * gain)
                along, across = on_map(way, period * v_y, incline)
                motion[i, 0] += c * along - s * across
                motion[i, 1] += s * along + c * across
                motion[i, 2] += bend
                motion[i, 3] += gain
            force, turning = a, w
        if steps[i] > 0:
            motion[i, 5] = turning


@loop
def slips_now(motion, values, rows, answers, steps, k):
    """Pose, slips and side slip of now into the answers (N,) of the slip observer, which hold those
    of `steps` (N,) ago; motion (N, 6) and values (N, CHANNELS) are of now. With g = -dV/di, the
    variance of a speed V of a track is g^2 times that of its slip. The speed of then is as sure as
    its slips; a bias b and white noise s of the accelerometer add T^2 b^2 + T dt s^2 within T, and
    the turn of now is the gyro's."""
    for i in range(motion.shape[0]):
        row, x, p = rows[i], answers[i].value, answers[i].covariance
        time = steps[i] * k.period
        shared = outage.speed_variance(x, p, row.belt[0], row.belt[1], k)
        shared += time * time * row.speed[outage.P_BB]
        shared += time * k.period * k.acceleration_variance
        if steps[i] > 0:
            shared += outage.HANDOVER * outage.HANDOVER
        turn = 0.25 * (k.gyro_variance + row.heading[outage.P_BB])
        turn /= k.inverse_gauge * k.inverse_gauge
        rises = (1.0, 1.0)
        for side in range(2):
            belt = k.radius * values[i, _SPROCKET + side]
            speed = motion[i, 3] + (side - 0.5) * motion[i, 5] / k.inverse_gauge
            state = SLIP_LEFT + side
            if abs(belt) < step.FASTEST_BELT and abs(belt) > k.standing_belt:
                x[state] = min(max(slip_ratio(belt, speed), -SLIP_LIMIT), SLIP_LIMIT)
                rise = outage.steepness(belt, x[state], k)
                noise = k.belt_variance * (speed / belt) ** 2
                p[state, :] = 0.0
                p[:, state] = 0.0
                p[state, state] = min(
                    (shared + turn + noise) / (rise * rise),
                    kinematics.SLIP_VARIANCE,
                )
            else:
                rise = math.inf
            rises = (rise, rises[1]) if side == 0 else (rises[0], rise)
        cross = (shared - turn) / (rises[0] * rises[1])
        p[SLIP_LEFT, SLIP_RIGHT] = p[SLIP_RIGHT, SLIP_LEFT] = cross
        for a in range(3):
            x[a] = motion[i, a]
        if abs(motion[i, 3]) > kinematics.STANDING_VEHICLE:
            x[SIDE_SLIP] = math.atan(motion[i, 4] / motion[i, 3])


class MotionFilter:
    """Reader and slip observer of N vehicles.

    parameters: nominal ones. control_period [s]: between two observations. data_sheet: noise of the
    sensors, `rtk` by default. lateral: lateral model of the nominal model. attitude: True where
    roll, pitch and rate of pitch are observed; else the ground counts as level.
    observation: (N, SIZE), then a column for each field of `needs` that is not of v0, as
    `observation.View` gives it.
    Raises ValueError for arguments outside their range.
    """

    slip_kind: type[SlipObserver] = SlipObserver

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
        lateral: str = "sliding",
        attitude: bool = False,
    ) -> None:
        p = plant_parameters() if parameters is None else parameters
        sheet = DataSheet() if data_sheet is None else data_sheet
        self.reader = ObservationReader(control_period, count, sheet.pose_delay)
        self.parameters, self.control_period = p, self.reader.control_period
        self.setting = Setting(p, self.control_period, sheet, self.count, lateral, bool(attitude))
        self.slip = self.slip_kind(*self.setting)
        self._hold_state_of([self.reader, self.slip])
        self._date, self._advance = BoundOnce(date), BoundOnce(advance)
        self._no_steps, self._none = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
        self._use_fields(ATTITUDE if attitude else ())
        soil = np.array([drive_limits(p).effort_maximum, p.shear_deformation_modulus])
        covariance = np.diag((np.array(PRIOR_SIGMA) * soil) ** 2)
        self._ground = (
            np.tile(soil, (count, 1)),
            np.tile(covariance, (count, 1, 1)),
            np.full(count, float(p.lateral_resistance)),
        )

    def _use_fields(self, names: Sequence[str]) -> None:
        """Read these fields of the observation besides the sensors."""
        self._added = tuple(names)
        self._behind = [name for name in names if name not in layout.INDEX]
        places = layout.INDEX | {name: layout.SIZE + k for k, name in enumerate(self._behind)}
        scales = {f.name: f.scale for group in layout.GROUPS.values() for f in group.fields}
        self._columns = [(name, places[name], scales[name]) for name in names]
        self._shape = (self.count, layout.SIZE + len(self._behind))

    def _hold_state_of(self, parts: Sequence[Any]) -> None:
        """The whole state is that of these parts."""
        self._with_state = parts
        arrays = [(part, name) for part in parts for name in ("memory", "ring")]
        self._places = [(part, name) for part, name in arrays if hasattr(part, name)]

    def hold_state_of(self, part: Any) -> None:
        """Let the state of a `Stateful` part be one with that of the filter."""
        self._hold_state_of([*self._with_state, part])

    @property
    def needs(self) -> tuple[str, ...]:
        """Fields of the observation that are read; registered ones come last."""
        return (*NEEDS, *self._added)

    @property
    def count(self) -> int:
        """Number of vehicles."""
        return len(self.reader.memory)

    def _arrays(self) -> list[Floats]:
        """The whole state."""
        return [getattr(part, name) for part, name in self._places]

    def memories(self) -> Memories:
        """A copy of the whole state; `restore` puts it back."""
        return tuple([array.copy() for array in self._arrays()])

    def restore(self, memories: Memories, rows: NDArray[np.bool_] | None = None) -> None:
        """Go on from what `memories` returned, in the rows marked (N,) or in all.

        Raises ValueError, before anything is changed, for the state of another batch.
        """
        arrays = self._arrays()
        for array, memory in zip(arrays, memories, strict=True):
            if len(memory) != len(array):
                raise ValueError(f"state of {len(memory)} vehicles; must be of {len(array)}")
            if memory.shape != array.shape:
                raise ValueError(
                    f"state with {memory.shape[1]} columns; must have {array.shape[1]}. "
                    "Is it of a stack with another control period?"
                )
        where = slice(None) if rows is None else rows
        for array, memory in zip(arrays, memories, strict=True):
            array[where] = memory[where]

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        for part in self._with_state:
            part.reset(rows)

    def read(
        self, observation: NDArray[np.float32], start: NDArray[np.bool_]
    ) -> tuple[Reading, Moment]:
        """What an observation says, and the moment of its pose: that of now, where poses are not
        late. Rows with `start` begin anew.

        Raises ValueError for a wrong shape, and for a reference, action or age that is not finite;
        the state is then unchanged.
        """
        if observation.shape != self._shape:
            behind = f" (the last for {', '.join(self._behind)})" if self._behind else ""
            raise ValueError(
                f"observation has shape {observation.shape}; must be {self._shape}{behind}. "
                "Is the stack made for another count?"
            )
        row, column, starts = inspect(observation, start)
        if row >= 0:
            raise ValueError(
                f"observation[{row}]: {layout.NAMES[column]} = {observation[row, column]}; must be "
                "finite. Only sensors may be NaN. Did a wrapper divide by zero?"
            )
        if starts:
            self.reset(start)
        reader, reading = self.reader, self.reader.read(observation)
        latest, paired, delay = reading.latest, reading.paired, reading.drive_delay
        if reader.lag == 0:
            return reading, Moment(latest, paired, delay, self._no_steps, self._none)
        apart = self._no_steps.copy(), self._none.copy()
        moment = Moment(latest.copy(), paired.copy(), delay.copy(), *apart)
        look_back(reader.rows, reader.rings, reader.control_period, reader.lag, moment)
        return reading, moment

    def _with_fields(
        self, observation: NDArray[np.float32], *measurements: Measurement
    ) -> Sequence[Measurement]:
        """The measurements with the fields besides sensors, (N,) SI by name, if there are any."""
        if not self._added:
            return measurements
        added = {
            name: np.multiply(observation[:, column], scale, dtype=np.float64)
            for name, column, scale in self._columns
        }
        return [measurement.with_fields(added) for measurement in measurements]

    def filter(
        self, latest: Measurement, paired: Measurement, moment: Moment
    ) -> tuple[Floats, NDArray[Any]]:
        """The motion (N, 6) of now, and the answer of the slip observer.

        latest, paired: those of the moment, where they need be with fields added. Ages in `latest`
        become those at the time of the filter, velocities in `paired` the filtered ones.
        """
        behind, attitude, reader = np.empty(self.count), latest.attitude, self.reader
        self._date(latest.age, moment.drive_delay, behind)
        if reader.lag > 0:
            answer = self._filtered(latest, moment.waits)
        else:
            answer = self.slip.compute(latest)
        motion = self.slip.motion_rows()
        self._advance(motion, behind, paired.values, attitude)
        if reader.lag > 0:
            period, steps = reader.control_period, moment.steps
            carry(motion, reader.rows, reader.rings, period, steps, self.slip.rows, attitude)
        return motion, answer

    def _filtered(self, samples: Measurement, waits: NDArray[np.bool_]) -> NDArray[Any]:
        """The slip observer's answer; rows that wait stay where they were."""
        if not waits.any():
            return self.slip.compute(samples)
        before = [array[waits] for array in arrays_of(self.slip)]
        answer = self.slip.compute(samples)
        for array, old in zip(arrays_of(self.slip), before, strict=True):
            array[waits] = old
        rows = self.slip.rows[waits]
        answer["value"][waits], answer["covariance"][waits] = rows["state"], rows["covariance"]
        return answer

    def estimate_now(
        self, answer: NDArray[Any], motion: Floats, moment: Moment, values: Floats
    ) -> Estimate:
        """The Estimate of now of the answer at a moment; see `slips_now`."""
        now = answer.copy()
        slips_now(motion, values, self.slip.rows, now, moment.steps, self.slip.model)
        return self.slip.estimate(now)

    def update(self, observation: NDArray[np.float32], start: NDArray[np.bool_]) -> Any:
        """The FilteredMotion by one observation of every vehicle; see `read`."""
        reading, moment = self.read(observation, start)
        (latest,) = self._with_fields(observation, moment.samples)
        self.slip.take_ground(*self._ground)
        motion, answer = self.filter(latest, moment.paired, moment)
        return FilteredMotion(reading.latest, reading.reference, motion, answer)
