"""Sensor channels that are sampled where an observation shows them: attitude, registered ones.

A channel is sampled whenever its group is, in the same steps and with the same delay:
    sample = truth + s b + sigma n,    n ~ N(0, 1),  s = -1 or +1 for the episode
from a stream of its own, seeded by the noise seed of the episode and the name of the channel: what
an environment shows never changes the other noise, the vehicle, the soil or the reference. The
attitude's true values are computed in the kernel (`physics.channels.attitude_signals`), those of
registered channels by the function that they carry.

Where the goal of a planned reference is, as the vehicle's measured pose has it.

With the delivered samples x, y, yaw and the goal (x_g, y_g, yaw_g) of the reference's last row:
    goal_x, goal_y       = R_z(-yaw) (x_g - x, y_g - y)
    goal_cosine, _sine   = cos, sin of yaw_g - yaw
    goal_time            = max(t_g - t, 0), until the plan arrives
The pose keeps its last sample where the state is not finite, so these are finite too.

Heights of the ground around a vehicle, as a depth sensor gives them in the yaw frame.

For a point at (a, b) contact lengths l ahead and to the left, at the true heading:
    measured = h(P) - z + sigma n,   P = (x, y) + l R_z(yaw) (a, b),   n ~ N(0, 1)
z is the height of the vehicle as the state has it, so that level ground at rest reads 0. Every
point of every control step is lost with the probability DROPOUT; then its last value stays, as it
does where the state is not finite. Where the sensors of the episode have no error, neither has this
one. Random numbers come from a stream of its own, seeded by the noise seed of the episode and the
name of the group: nothing else changes by it.

Assumptions: no delay, no occlusion; the sensor is levelled and knows its own height without error.

Observations of other groups than the compiled loops write, and registered sensor channels.

The kernels write the fields of `observation.V0`, which `Composer` picks from and adds to. It runs
only where the layout of an environment is another one: channels are sampled (`added_channels`),
computed groups get what they read, and one kernel writes all fields, scaled and clipped. A group
that is computed by a function in Python costs 10 us and more a step, a compiled one 1 us.
"""

import copy
import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env import sensors
from tracked_env.engine import noise
from tracked_env.engine.episode import Episode, longest_delay_steps
from tracked_env.observation import Group
from tracked_env.physics import parameters as s
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX, STATE_NAMES
from tracked_env.physics.reference_profile import goal_of
from tracked_env.plants import Ground
from tracked_env.sensors import ADDED, ATTITUDE, CHANNEL_COUNT, CHANNELS, GROUPS

NOISE_BLOCK = 64  # [steps] noise drawn at once per vehicle and channel
_RUNNING = ("errors", "noise", "blocks", "past", "streams")
Values = NDArray[np.float64]
_TRUE = {
    **{name: b.STATE + row for row, name in enumerate(STATE_NAMES)},
    **{name: b.PARAMETERS + row for name, row in PARAMETER_INDEX.items()},
}
_COMPILED = {channel.name: place for place, channel in enumerate(ATTITUDE)}


class Named(Mapping[str, Values]):
    """Arrays by name, each made when it is asked for."""

    def __init__(self, columns: Mapping[str, int], read: Callable[[int], Values]) -> None:
        self._columns, self._read = columns, read

    def __getitem__(self, name: str) -> Values:
        return self._read(self._columns[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


def checked(source: str, values: Mapping[str, Any], name: str, count: int) -> Values:
    """One of `values`, () or (count,). Raises ValueError where it is missing or misshapen."""
    if name not in values:
        raise ValueError(f"{source}: no value of {name!r}; there are {sorted(values)}")
    value = np.asarray(values[name], dtype=np.float64)
    if value.shape not in ((), (count,)):
        raise ValueError(f"{source} of {name!r} has shape {value.shape}; must be ({count},)")
    return value


@loop
def _deliver(floats, counters, rows, table, errors, noise, blocks, past, delivered):
    """Sample the channels of `rows` (n,), and pass on what has arrived: delivered (n, C).

    table (2, C): sampling group, place in ATTITUDE or -1. delivered holds the true values where
    that is -1. errors (N, 3, C): sigma, signed bias, latest sample; noise (N, C, NOISE_BLOCK) of
    block number `blocks` (N,); past (N, slots, C). Returns how many vehicles need new noise.
    """
    needed, slots = 0, past.shape[1]
    for k in range(rows.size):
        i = rows[k]
        step = counters[i, b.STEP]
        slot = step % slots
        attitude = sensors.attitude_signals(floats, i)
        for c in range(table.shape[1]):
            group, place = table[0, c], table[1, c]
            truth = attitude[place] if place >= 0 else delivered[k, c]
            if floats[i, b.SAMPLE + CHANNEL_COUNT + group] == step:
                error = errors[i, 0, c] * noise[i, c, step % NOISE_BLOCK]
                errors[i, 2, c] = truth + errors[i, 1, c] + error
            past[i, slot, c] = errors[i, 2, c]
            delivered[k, c] = past[i, max(step - counters[i, b.DELAY + group], 0) % slots, c]
        needed += (step + 1) // NOISE_BLOCK > blocks[i]
    return needed


class AddedChannels:
    """Some of these channels, of N vehicles. Raises ValueError for one that is not registered."""

    def __init__(self, names: tuple[str, ...], count: int, control_period: float) -> None:
        for name in names:
            if name not in ADDED:
                raise ValueError(f"no sensor channel {name!r}; registered are {sorted(ADDED)}")
        self.names = names
        groups = [GROUPS.index(ADDED[name].group) for name in names]
        places = [_COMPILED.get(name, -1) for name in names]
        self._table = np.array([groups, places], dtype=np.int64).reshape(2, len(names))
        self._python = [c for c, place in enumerate(places) if place < 0]
        self._errors = np.zeros((count, 3, len(names)))
        self._noise = np.zeros((count, len(names), NOISE_BLOCK))
        self._blocks = np.zeros(count, dtype=np.int64)
        self._past = np.zeros((count, longest_delay_steps(control_period) + 1, len(names)))
        self._streams: list[list[np.random.Generator]] = [[] for _ in range(count)]

    @property
    def running(self) -> dict[str, Any]:
        """All that changes while episodes run, the arrays and generators themselves."""
        return {name: getattr(self, f"_{name}") for name in _RUNNING}

    @running.setter
    def running(self, values: Mapping[str, Any]) -> None:
        for name in _RUNNING:
            setattr(self, f"_{name}", values[name])

    def start(self, i: int, episode: Episode) -> None:
        """Begin an episode on vehicle i."""
        seeds = [[episode.noise_seed, zlib.crc32(name.encode())] for name in self.names]
        self._streams[i] = [np.random.Generator(np.random.SFC64(seed)) for seed in seeds]
        for c, (_name, sigma, bias) in enumerate(episode.sensors.added):
            self._errors[i, 0, c] = sigma
            self._errors[i, 1, c] = -bias if self._streams[i][c].random() < 0.5 else bias
        self._draw(i)
        self._blocks[i] = 0

    def _draw(self, i: int) -> None:
        for c, stream in enumerate(self._streams[i]):
            self._noise[i, c] = stream.standard_normal(NOISE_BLOCK)

    def deliver(self, batch: b.Batch, rows: NDArray[np.int64], delivered: Values) -> None:
        """Sample now, and write the samples that have arrived into delivered (n, channels)."""
        floats, counters = batch.floats, batch.counters
        if self._python:
            truth = Named(_TRUE, lambda column: floats[rows, column])
            for c in self._python:
                name = self.names[c]
                of_truth = ADDED[name].truth
                assert of_truth is not None
                delivered[:, c] = checked("truth", {name: of_truth(truth)}, name, rows.size)
        needed = _deliver(
            floats, counters, rows, self._table, self._errors, self._noise, self._blocks,
            self._past, delivered,
        )  # fmt: skip
        if needed:
            blocks = (counters[rows, b.STEP] + 1) // NOISE_BLOCK
            for i, block in zip(rows.tolist(), blocks.tolist(), strict=True):
                if block > self._blocks[i]:
                    self._draw(i)
                    self._blocks[i] = block


_X, _Y, _YAW = (CHANNELS.index(name) for name in ("x", "y", "yaw"))


@loop
def _read(floats, counters, profile, rows, pose, period, shown):
    """Fill shown (n, 5); pose: column of the delivered samples, period [s] of a control step."""
    for k in range(rows.size):
        i = rows[k]
        x, y, yaw, time = goal_of(profile[:, i])
        dx, dy = x - floats[i, pose + _X], y - floats[i, pose + _Y]
        cosine, sine = rotation(floats[i, pose + _YAW])
        shown[k, 0], shown[k, 1] = cosine * dx + sine * dy, cosine * dy - sine * dx
        shown[k, 2], shown[k, 3] = rotation(yaw - floats[i, pose + _YAW])
        shown[k, 4] = max(time - counters[i, b.STEP] * period, 0.0)


def read_goal(
    batch: b.Batch, rows: NDArray[np.int64], period: float, shown: NDArray[Any]
) -> None:  # fmt: skip
    """The goals of the vehicles `rows` into shown (n, 5); period [s]: of a control step."""
    delivered = b.SAMPLE if batch.history.shape[1] == 1 else b.DELIVERED
    _read(batch.floats, batch.counters, batch.profile, rows, delivered, period, shown)


NOISE = 0.02  # [m] sigma, of a depth camera or lidar at a few metres
DROPOUT = 0.02  # [-] of a point in a control step
_LOST = float(ndtri(DROPOUT))  # [-] a normal number below it loses the point
_LENGTH = b.BASE + PARAMETER_INDEX["contact_length"]
_SEEDS = 2**63  # [-] of `noise.seed_state`
Floats = NDArray[np.float64]


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
def _measure(floats, counters, rows, heights, held, states, noisy, shown):
    """Readings shown (n, M) [m] where the ground has these heights (n, M) [m].

    held (N, M): the last readings; states (N, noise.STATE) and noisy (N,): of the streams.
    """
    count = heights.shape[1]
    normal = np.zeros(2 * count, dtype=np.float32)
    for k in range(rows.size):
        i = rows[k]
        if noisy[i]:
            noise.fill_normal(states[i], normal)
        else:
            normal[:] = 0.0
        started = counters[i, b.STEP] > 0
        for m in range(count):
            value = heights[k, m] - floats[i, b.STATE + s.Z] + NOISE * normal[m]
            if not (started and (normal[count + m] < _LOST or not math.isfinite(value))):
                held[i, m] = value
            shown[k, m] = held[i, m]


class HeightScan:
    """The same points around each of N vehicles."""

    def __init__(self, name: str, points: tuple[tuple[float, float], ...], count: int) -> None:
        """name: of its group; points: (ahead, left) [contact lengths] each."""
        self._name, self._points = zlib.crc32(name.encode()), np.array(points)
        self._held = np.zeros((count, len(points)))
        self._states = np.zeros((count, noise.STATE), dtype=np.uint64)
        self._noisy = np.zeros(count, dtype=np.bool_)

    @property
    def running(self) -> dict[str, Any]:
        """All that changes while episodes run, the arrays themselves."""
        return {"held": self._held, "states": self._states, "noisy": self._noisy}

    @running.setter
    def running(self, values: Mapping[str, Any]) -> None:
        self._held, self._states = values["held"], values["states"]
        self._noisy = values["noisy"]

    def start(self, i: int, episode: Episode) -> None:
        """Begin an episode on vehicle i."""
        self._noisy[i] = episode.sensors.noisy
        noise.seed_state(self._states[i], (episode.noise_seed ^ (self._name << 31)) % _SEEDS)

    def read(
        self, batch: b.Batch, rows: NDArray[np.int64], ground: Ground | None, shown: Floats
    ) -> None:
        """Readings around the vehicles `rows` into shown (n, M) [m]; ground: None is level."""
        places = np.zeros((2, rows.size, len(self._points)))
        if ground is None:
            heights = places[0]
        else:
            _place(batch.floats, rows, self._points, places[0], places[1])
            heights = ground.heights(batch.floats, rows, places[0], places[1])
        _measure(
            batch.floats, batch.counters, rows, heights, self._held, self._states, self._noisy,
            shown,
        )  # fmt: skip


@loop
def _gather(written, delivered, rows, sources, scale, known):
    """SI values known (n, K) of fields of V0, `sources` below SIZE, and of delivered samples."""
    for k in range(rows.size):
        for j in range(sources.size):
            source = sources[j]
            if source < written.shape[1]:
                known[k, j] = np.float64(written[rows[k], source]) * scale[source]
            else:
                known[k, j] = delivered[k, source - written.shape[1]]


@loop
def _show(written, delivered, shown, rows, sources, scale, bound, out):
    """Write out (N, D): fields of V0 as they are, samples and shown values scaled and clipped.

    sources (D,): column in written, delivered and shown side by side.
    """
    own, later = written.shape[1], written.shape[1] + delivered.shape[1]
    for k in range(rows.size):
        i = rows[k]
        for d in range(sources.size):
            source = sources[d]
            if source < own:
                out[i, d] = written[i, source]
            else:
                value = delivered[k, source - own] if source < later else shown[k, source - later]
                out[i, d] = min(max(value / scale[d], -bound[d]), bound[d])


class Composer:
    """Writes the observations of N vehicles in a layout other than that of the kernels.

    `written` (N, SIZE) is what the kernels write. Raises ValueError for a channel that is not
    registered.
    """

    def __init__(self, layout: obs.Layout, count: int, control_period: float) -> None:
        self.layout, self._period = layout, control_period
        self.written: NDArray[np.float32] = np.zeros((count, obs.SIZE), dtype=np.float32)
        self._channels = AddedChannels(layout.channels, count, control_period)
        scans = {group.name: group.scan for group in layout.parts if group.scan}
        self._scans = {name: HeightScan(name, points, count) for name, points in scans.items()}
        # What fields are made of: columns in `written`, delivered and shown, side by side.
        self._places = {name: k for k, name in enumerate((*obs.NAMES, *layout.channels))}
        self._computed: list[tuple[Group, slice, NDArray[np.int64]]] = []
        first, sources = 0, list[int]()
        for group in layout.parts:
            made = bool(group.values or group.compiled or group.scan or group.goal)
            for field in group.fields:
                sources.append(self._places[field.name] if not made else len(self._places) + first)
                first += 1 if made else 0
            if made:
                read = np.array([self._places[name] for name in group.reads], dtype=np.int64)
                own = slice(first - len(group.fields), first)
                self._computed.append((group, own, read))
        self._sources = np.array(sources, dtype=np.int64)
        self._scale, self._bound = layout.scale, layout.bound.astype(np.float64)
        # Of the rows in hand, overwritten in every step:
        self._delivered = np.zeros((count, len(layout.channels)))
        self._shown = np.zeros((count, first))

    def snapshot(self) -> dict[str, Any]:
        """All that changes while episodes run, as plain data. `resume` goes on from it."""
        scans = {name: scan.running for name, scan in self._scans.items()}
        now = {"written": self.written, "channels": self._channels.running, "scans": scans}
        return copy.deepcopy(now)

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from what `snapshot` returned, of the same layout and count."""
        given = copy.deepcopy(dict(snapshot))
        self.written, self._channels.running = given["written"], given["channels"]
        for name, scan in self._scans.items():
            scan.running = given["scans"][name]

    def start(
        self,
        batch: b.Batch,
        out: NDArray[np.float32],
        rows: NDArray[np.int64],
        episodes: Sequence[Episode],
        ground: Ground | None,
    ) -> None:
        """Begin an episode on `rows`, and write what is seen there into out (N, D).

        ground: of the plant; None is level.
        """
        for i, episode in zip(rows.tolist(), episodes, strict=True):
            self._channels.start(i, episode)
            for scan in self._scans.values():
                scan.start(i, episode)
        self.write(batch, out, rows, 0, rows.size, ground)

    def write(
        self,
        batch: b.Batch,
        out: NDArray[np.float32],
        chosen: NDArray[np.int64],
        start: int,
        stop: int,
        ground: Ground | None,
    ) -> None:
        """Write what is seen of vehicles chosen[start:stop] now into out (N, D).

        Threads may write other vehicles at the same time.
        """
        if start >= stop:
            return
        rows = chosen[start:stop]
        delivered, shown = self._delivered[start:stop], self._shown[start:stop]
        if self._channels.names:
            self._channels.deliver(batch, rows, delivered)
        for group, own, read in self._computed:
            values = shown[:, own]
            if group.name in self._scans:
                self._scans[group.name].read(batch, rows, ground, values)
            elif group.goal:
                read_goal(batch, rows, self._period, values)
            elif group.compiled is not None:
                known = np.empty((rows.size, read.size))
                _gather(self.written, delivered, rows, read, obs.SCALE, known)
                group.compiled(known, values)
            else:
                self._computed_in_python(group, rows, delivered, values)
        _show(
            self.written, delivered, shown, rows, self._sources, self._scale, self._bound, out
        )  # fmt: skip

    def _computed_in_python(
        self, group: Group, rows: NDArray[np.int64], delivered: Values, shown: Values
    ) -> None:
        """The fields of a group from its function `values`."""

        def known(place: int) -> Values:
            if place >= obs.SIZE:
                return delivered[:, place - obs.SIZE].copy()
            return self.written[rows, place].astype(np.float64) * obs.SCALE[place]

        assert group.values is not None
        values = group.values(Named(self._places, known))
        for k, field in enumerate(group.fields):
            shown[:, k] = checked(group.name, values, field.name, rows.size)
