"""Observations of other groups than the compiled loops write, and registered sensor channels.

The kernels write the fields of `observation.V0`, which `Composer` picks from and adds to where the
layout of an environment is another one: what computed groups read is sampled, each group is
computed, and one kernel writes all fields, scaled and clipped.

Channels of the attitude and registered ones are sampled whenever their sampling group is, in the
same steps and with the same delay:
    sample = truth + s b + sigma n,    n ~ N(0, 1),  s = -1 or +1 for the episode
The height scan reads the ground as a levelled depth sensor does, which knows its own height: for a
point (a, b) contact lengths l ahead and to the left, at the true heading,
    measured = h(P) - z + sigma n,   P = (x, y) + l R_z(yaw) (a, b),   n ~ N(0, 1)
z is the height of the vehicle as the state has it, so that level ground at rest reads 0. Every
point of every control step is lost with the probability DROPOUT; then its last value stays, as it
does where the state is not finite. Where the sensors of the episode have no error, neither has this
one. No delay, no occlusion.
The goal (x_g, y_g, yaw_g) of a planned reference is shown by the delivered samples x, y, yaw:
    goal_x, goal_y       = R_z(-yaw) (x_g - x, y_g - y)
    goal_cosine, _sine   = cos, sin of yaw_g - yaw
    goal_time            = max(t_g - t, 0), until the plan arrives
The data sheet is that of the nominal vehicle, drawn or not: logarithms of its parameters, each with
an error of either sign, ln(1 + `data_sheet_error`) of the sensors, that stays for the episode. With
the length l of that sheet `relative` shows each field of V0 over the unit that l and gravity make
of it (lengths over l, times over sqrt(l / g)), drives over their limits.
Channels, scans and sheets draw from streams of their own, seeded by the noise seed of the episode
and their name: what an environment shows changes neither the other noise, vehicle, soil nor
reference.
"""

import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env import sensors, streams
from tracked_env.physics import parameters as s
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX
from tracked_env.physics.reference_profile import goal_of
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants import Ground

NOISE_BLOCK = 64  # [steps] noise drawn at once per vehicle and channel
NOISE = 0.02  # [m] sigma of the height scan, of a depth camera or lidar at a few metres
DROPOUT = 0.02  # [-] of a point in a control step
_LOST = float(ndtri(DROPOUT))  # [-] a normal number below it loses the point
_LENGTH = b.BASE + PARAMETER_INDEX["contact_length"]
_SEEDS = 2**63  # [-] of `streams.seed_state`
_X, _Y, _YAW = (sensors.CHANNELS.index(name) for name in ("x", "y", "yaw"))
_COMPILED = {channel.name: place for place, channel in enumerate(sensors.ATTITUDE)}
Values = NDArray[np.float64]
Shown = NDArray[np.float32]


class Truth(dict[str, Values]):
    """True state and parameters (n,) of some vehicles by name, each read when it is asked for."""

    def __init__(self, batch: b.Batch, rows: NDArray[np.int64]) -> None:
        super().__init__()
        self._batch, self._rows = batch, rows

    def __missing__(self, name: str) -> Values:
        return self._batch.column(name)[self._rows]


@loop
def _deliver(arrays, rows, table, errors, noise, past, delivered):
    """Sample the channels of `rows` (n,), and pass on what has arrived: delivered (n, C).

    arrays: floats, counters. table (2, C): sampling group, place in ATTITUDE or -1. delivered holds
    the true values where that is -1. errors (N, 3, C): sigma, signed bias, latest sample; noise
    (N, C, NOISE_BLOCK); past (N, slots, C). Returns how many vehicles have used up their noise.
    """
    floats, counters = arrays
    used_up, slots = 0, past.shape[1]
    for k in range(rows.size):
        i = rows[k]
        step = counters[i, b.STEP]
        slot = step % slots
        attitude = sensors.attitude_signals(floats, i)
        for c in range(table.shape[1]):
            group, place = table[0, c], table[1, c]
            truth = attitude[place] if place >= 0 else delivered[k, c]
            if floats[i, b.SAMPLE + sensors.CHANNEL_COUNT + group] == step:
                error = errors[i, 0, c] * noise[i, c, step % NOISE_BLOCK]
                errors[i, 2, c] = truth + errors[i, 1, c] + error
            past[i, slot, c] = errors[i, 2, c]
            delivered[k, c] = past[i, max(step - counters[i, b.DELAY + group], 0) % slots, c]
        used_up += (step + 1) % NOISE_BLOCK == 0
    return used_up


@loop
def _place(floats, rows, points, x, y):
    """Places x, y (n, M) [m] of the points (M, 2) [contact lengths] around the vehicles `rows`."""
    for k in range(rows.size):
        i = rows[k]
        cosine, sine = rotation(floats[i, b.STATE + s.YAW])
        length = floats[i, _LENGTH]
        for m in range(points.shape[0]):
            ahead, left = length * points[m, 0], length * points[m, 1]
            x[k, m] = floats[i, b.STATE + s.X] + cosine * ahead - sine * left
            y[k, m] = floats[i, b.STATE + s.Y] + sine * ahead + cosine * left


@loop
def _measure(arrays, rows, heights, latest, states, noisy, outputs):
    """Readings, outputs (n, M) [m], where the ground has these heights (n, M) [m].

    arrays: floats, counters. latest (N, M): the last readings; states (N, streams.STATE) and noisy
    (N,): of the streams.
    """
    (floats, counters), count = arrays, heights.shape[1]
    normal = np.zeros((2, count), dtype=np.float32)
    for k in range(rows.size):
        i = rows[k]
        if noisy[i]:
            streams.fill_normal(states[i], normal)
        else:
            normal[:, :] = 0.0
        started = counters[i, b.STEP] > 0
        for m in range(count):
            value = heights[k, m] - floats[i, b.STATE + s.Z] + NOISE * normal[0, m]
            if not (started and (normal[1, m] < _LOST or not math.isfinite(value))):
                latest[i, m] = value
            outputs[k, m] = latest[i, m]


@loop
def _read_goal(arrays, rows, pose, period, outputs):
    """Goals of the vehicles `rows` into outputs (n, 5).

    arrays: floats, counters, profile. pose: column of the delivered samples; period [s]: of a
    control step.
    """
    floats, counters, profile = arrays
    for k in range(rows.size):
        i = rows[k]
        x, y, yaw, time = goal_of(profile[:, i])
        dx, dy = x - floats[i, pose + _X], y - floats[i, pose + _Y]
        cosine, sine = rotation(floats[i, pose + _YAW])
        outputs[k, 0], outputs[k, 1] = cosine * dx + sine * dy, cosine * dy - sine * dx
        outputs[k, 2], outputs[k, 3] = rotation(yaw - floats[i, pose + _YAW])
        outputs[k, 4] = max(time - counters[i, b.STEP] * period, 0.0)


@loop
def _gather(written, delivered, rows, sources, scale, inputs):
    """SI values, inputs (n, K), of fields of V0, `sources` below SIZE, and of delivered samples."""
    for k in range(rows.size):
        for j in range(sources.size):
            source = sources[j]
            if source < written.shape[1]:
                inputs[k, j] = np.float64(written[rows[k], source]) * scale[source]
            else:
                inputs[k, j] = delivered[k, source - written.shape[1]]


@loop
def _show(written, delivered, computed, rows, sources, scale, bound, out):
    """Write out (N, D): fields of V0 as they are, samples and computed values scaled and clipped.

    sources (D,): column in written, delivered and computed side by side.
    """
    first_sample, first_computed = written.shape[1], written.shape[1] + delivered.shape[1]
    for k in range(rows.size):
        i = rows[k]
        for d in range(sources.size):
            source = sources[d]
            if source < first_sample:
                out[i, d] = written[i, source]
            else:
                place = source - first_sample
                value = (
                    delivered[k, place]
                    if source < first_computed
                    else computed[k, source - first_computed]
                )
                out[i, d] = min(max(value / scale[d], -bound[d]), bound[d])


class AddedChannels:
    """Some of the channels of `sensors.ADDED`, of N vehicles. Raises ValueError for another one."""

    def __init__(self, names: tuple[str, ...], count: int, control_period: float) -> None:
        for name in names:
            if name not in sensors.ADDED:
                known = sorted(sensors.ADDED)
                raise ValueError(f"no sensor channel {name!r}; registered are {known}")
        self.names = names
        groups = [sensors.GROUPS.index(sensors.ADDED[name].group) for name in names]
        places = [_COMPILED.get(name, -1) for name in names]
        self._table = np.array([groups, places], dtype=np.int64).reshape(2, len(names))
        self._python = [c for c, place in enumerate(places) if place < 0]
        self.errors = np.zeros((count, 3, len(names)))
        self.noise = np.zeros((count, len(names), NOISE_BLOCK))
        self.past = np.zeros((count, sensors.longest_delay_steps(control_period) + 1, len(names)))
        self.streams: list[list[np.random.Generator]] = [[] for _ in range(count)]

    def start(self, i: int, seed: int, draw: sensors.SensorDraw, nominal: Any) -> None:
        """Begin an episode on vehicle i."""
        seeds = [[seed, zlib.crc32(name.encode())] for name in self.names]
        self.streams[i] = [np.random.Generator(np.random.SFC64(one)) for one in seeds]
        for c, (_name, sigma, bias) in enumerate(draw.added[: len(self.names)]):
            self.errors[i, 0, c] = sigma
            self.errors[i, 1, c] = -bias if self.streams[i][c].random() < 0.5 else bias
        self._draw(i)

    def _draw(self, i: int) -> None:
        for c, stream in enumerate(self.streams[i]):
            self.noise[i, c] = stream.standard_normal(NOISE_BLOCK)

    def deliver(self, batch: b.Batch, rows: NDArray[np.int64], delivered: Values) -> None:
        """Sample now, and write the samples that have arrived into delivered (n, channels)."""
        truth = Truth(batch, rows)
        for c in self._python:
            of_truth = sensors.ADDED[self.names[c]].truth
            assert of_truth is not None
            value = np.asarray(of_truth(truth), dtype=np.float64)
            if value.shape not in ((), rows.shape):
                raise ValueError(
                    f"truth of {self.names[c]!r} has shape {value.shape}; must be {rows.shape}"
                )
            delivered[:, c] = value
        samples = (self.errors, self.noise, self.past)
        if _deliver(batch[:2], rows, self._table, *samples, delivered):
            for i in rows[(batch.counters[rows, b.STEP] + 1) % NOISE_BLOCK == 0].tolist():
                self._draw(i)


class HeightScan:
    """The same points around each of N vehicles."""

    def __init__(self, name: str, points: tuple[tuple[float, float], ...], count: int) -> None:
        """name: of its group; points: (ahead, left) [contact lengths] each."""
        self._name, self._points = zlib.crc32(name.encode()), np.array(points)
        self.latest = np.zeros((count, len(points)))
        self.states = np.zeros((count, streams.STATE), dtype=np.uint64)
        self.noisy = np.zeros(count, dtype=np.bool_)

    def start(self, i: int, seed: int, draw: sensors.SensorDraw, nominal: Any) -> None:
        """Begin an episode on vehicle i."""
        self.noisy[i] = draw.noisy
        streams.seed_state(self.states[i], (seed ^ (self._name << 31)) % _SEEDS)

    def measure(
        self, batch: b.Batch, rows: NDArray[np.int64], ground: Ground | None, outputs: Values
    ) -> None:
        """Readings around the vehicles `rows` into outputs (n, M) [m]; ground: None is level."""
        x, y = np.zeros((2, rows.size, len(self._points)))
        heights = x
        if ground is not None:
            _place(batch.floats, rows, self._points, x, y)
            heights = ground.heights(batch.floats, rows, x, y)
        _measure(batch[:2], rows, heights, self.latest, self.states, self.noisy, outputs)


class DataSheet:
    """The data sheet of N vehicles, and fields of V0 in its units."""

    def __init__(self, count: int) -> None:
        self.values = np.zeros((count, len(obs.SHEET)))  # logarithms
        self.divisors = np.ones((count, obs.SIZE))

    def start(self, i: int, seed: int, draw: sensors.SensorDraw, nominal: Any) -> None:
        """Begin an episode on vehicle i."""
        error = next((bias for name, _, bias in draw.added if name == sensors.SHEET), 0.0)
        stream = np.random.Generator(np.random.SFC64([seed, zlib.crc32(sensors.SHEET.encode())]))
        signs = np.where(stream.random(len(obs.SHEET)) < 0.5, -1.0, 1.0)
        self.values[i] = np.log([nominal[name] for name in obs.SHEET]) + error * signs
        said = dict(zip(obs.SHEET, np.exp(self.values[i]).tolist(), strict=True))
        length = said["contact_length"]
        units = {unit: length**a * GRAVITY**b for unit, (a, b) in obs.UNITS.items()}
        self.divisors[i] = [{**said, **units}.get(by, 1.0) for by in obs.GROUPS["relative"].sheet]

    def show(self, relative: bool, written: Shown, rows: NDArray[np.int64], out: Values) -> None:
        """Write the values (n, F) of the group of this kind."""
        out[:] = written[rows] * obs.SCALE / self.divisors[rows] if relative else self.values[rows]


class Composer:
    """Writes the observations of N vehicles in a layout other than that of the kernels.

    `written` (N, SIZE) is what the kernels write. ground: of the plant; None is level. Raises
    ValueError for a channel that is not registered.
    """

    def __init__(
        self, layout: obs.Layout, count: int, control_period: float, ground: Ground | None
    ) -> None:
        self._period, self._ground = control_period, ground
        self.written: NDArray[np.float32] = np.zeros((count, obs.SIZE), dtype=np.float32)
        self._channels = AddedChannels(layout.channels, count, control_period)
        self._scans = {g.name: HeightScan(g.name, g.scan, count) for g in layout.parts if g.scan}
        self._sheet = DataSheet(count)
        kept = {"data_sheet": self._sheet} if any(group.sheet for group in layout.parts) else {}
        self._parts: dict[str, Any] = {"channels": self._channels, **self._scans, **kept}
        # What fields are made of: columns in `written`, delivered and computed, side by side.
        self._places = {name: k for k, name in enumerate((*obs.NAMES, *layout.channels))}
        self._groups: list[tuple[obs.Group, slice, NDArray[np.int64]]] = []
        first, sources = 0, list[int]()
        for group in layout.parts:
            if group.compute or group.scan or group.goal or group.sheet:
                last = first + len(group.fields)
                sources += range(len(self._places) + first, len(self._places) + last)
                reads = np.array([self._places[name] for name in group.reads], dtype=np.int64)
                self._groups.append((group, slice(first, last), reads))
                first = last
            else:
                sources += [self._places[field.name] for field in group.fields]
        self._sources = np.array(sources, dtype=np.int64)
        self._scale, self._bound = layout.scale, layout.bound.astype(np.float64)
        # Of the rows in hand, overwritten in every step:
        self._delivered = np.zeros((count, len(layout.channels)))
        self._computed = np.zeros((count, first))

    def state(self) -> dict[str, Any]:
        """All that changes while episodes run, the arrays and generators themselves."""
        return {"written": self.written, **{n: vars(part) for n, part in self._parts.items()}}

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` returned, of the same layout and count."""
        self.written = state["written"]
        for name, part in self._parts.items():
            vars(part).update(state[name])

    def start(self, i: int, seed: int, draw: sensors.SensorDraw, nominal: Any) -> None:
        """Begin an episode on vehicle i, with this noise seed and these sensors.

        nominal: its record, see `drawing_laws`.
        """
        for part in self._parts.values():
            part.start(i, seed, draw, nominal)

    def write(
        self, batch: b.Batch, out: Shown, vehicles: NDArray[np.int64], first: int, last: int
    ) -> None:
        """Write what is seen of vehicles[first:last] now into out (N, D).

        Threads may write other vehicles at the same time.
        """
        rows = vehicles[first:last]
        delivered, computed = self._delivered[first:last], self._computed[first:last]
        if self._channels.names:
            self._channels.deliver(batch, rows, delivered)
        for group, columns, reads in self._groups:
            outputs = computed[:, columns]
            if group.scan:
                self._scans[group.name].measure(batch, rows, self._ground, outputs)
            elif group.sheet:
                self._sheet.show(group.name == "relative", self.written, rows, outputs)
            elif group.goal:
                pose = b.SAMPLE if batch.history.shape[1] == 1 else b.DELIVERED
                _read_goal(batch[:3], rows, pose, self._period, outputs)
            elif group.compute is not None:
                inputs = np.empty((rows.size, reads.size))
                _gather(self.written, delivered, rows, reads, obs.SCALE, inputs)
                group.compute(inputs, outputs)
        parts = self.written, delivered, computed
        _show(*parts, rows, self._sources, self._scale, self._bound, out)
