"""Observations of other groups than the compiled loops write, and registered sensor channels.

The kernels write the fields of `observation.V0`, which `Composer` picks from and adds to. It runs
only where the layout of an environment is another one. A registered channel is sampled whenever
its group is, in the same steps and with the same delay:
    sample = truth + s b + sigma n,    n ~ N(0, 1),  s = -1 or +1 for the episode
from a stream of its own, seeded by the noise seed of the episode and the name of the channel: what
an environment shows never changes the other noise, the vehicle, the soil or the reference.
"""

import copy
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env import observation as obs
from tracked_env.engine import columns as b
from tracked_env.engine.episode import Episode
from tracked_env.engine.height_scan import HeightScan
from tracked_env.physics.channels import CHANNEL_COUNT, GROUPS
from tracked_env.physics.parameters import PARAMETER_INDEX
from tracked_env.physics.state import STATE_NAMES
from tracked_env.plants import Ground
from tracked_env.sensor_draws import longest_delay_steps
from tracked_env.sensors import ADDED

NOISE_BLOCK = 64  # [steps] noise drawn at once per vehicle and channel
_RUNNING = (  # attributes that change while episodes run
    "written", "_sigma", "_bias", "_sample", "_noise", "_past", "_streams",
)  # fmt: skip
_TRUE = {
    **{name: b.STATE + row for row, name in enumerate(STATE_NAMES)},
    **{name: b.PARAMETERS + row for name, row in PARAMETER_INDEX.items()},
}
Values = NDArray[np.float64]


class _Named(Mapping[str, Values]):
    """Arrays by name, each made when it is asked for."""

    def __init__(self, columns: Mapping[str, int], read: Callable[[int], Values]) -> None:
        self._columns, self._read = columns, read

    def __getitem__(self, name: str) -> Values:
        return self._read(self._columns[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


class Composer:
    """Writes the observations of N vehicles in a layout other than that of the kernels.

    `written` (N, SIZE) is what the kernels write. Raises ValueError for a channel that is not
    registered.
    """

    def __init__(self, layout: obs.Layout, count: int, control_period: float) -> None:
        self.layout = layout
        self.written: NDArray[np.float32] = np.zeros((count, obs.SIZE), dtype=np.float32)
        for name in layout.channels:
            if name not in ADDED:
                raise ValueError(f"no sensor channel {name!r}; registered are {sorted(ADDED)}")
        clocks = [GROUPS.index(ADDED[name].group) for name in layout.channels]
        self._clocks = np.array(clocks, dtype=np.int64)  # sampling group of each channel
        copied = [name for name in layout.names if name in obs.INDEX]
        self._to = layout.columns(copied)
        self._from = obs.V0.columns(copied)
        self._columns = {
            group.name: layout.columns([field.name for field in group.fields])
            for group in layout.parts
        }
        self._scale = np.array([field.scale for field in layout.fields])
        self._bound = layout.bound.astype(np.float64)
        slots = longest_delay_steps(control_period) + 1 if layout.channels else 0
        shape = (count, len(layout.channels))
        self._sigma, self._bias, self._sample = np.zeros((3, *shape))
        self._noise = np.zeros((*shape, NOISE_BLOCK))
        self._past = np.zeros((count, slots, len(layout.channels)))
        self._streams: list[list[np.random.Generator]] = [[] for _ in range(count)]
        scans = {group.name: group.scan for group in layout.parts if group.scan}
        self._scans = {name: HeightScan(name, points, count) for name, points in scans.items()}

    def snapshot(self) -> dict[str, Any]:
        """All that changes while episodes run, as plain data. `resume` goes on from it."""
        state = {name: getattr(self, name) for name in _RUNNING}
        scans = {name: scan.running for name, scan in self._scans.items()}
        return copy.deepcopy({**state, "scans": scans})

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from what `snapshot` returned, of the same layout and count."""
        for name in _RUNNING:
            setattr(self, name, copy.deepcopy(snapshot[name]))
        for name, scan in self._scans.items():
            scan.running = copy.deepcopy(snapshot["scans"][name])

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
        for i, episode in zip(rows, episodes, strict=True):
            streams = [
                np.random.Generator(
                    np.random.SFC64([episode.noise_seed, zlib.crc32(name.encode())])
                )
                for name in self.layout.channels
            ]
            self._streams[i] = streams
            for scan in self._scans.values():
                scan.start(i, episode)
            for k, (_name, sigma, bias) in enumerate(episode.sensors.added):
                self._sigma[i, k] = sigma
                self._bias[i, k] = -bias if streams[k].random() < 0.5 else bias
        self.write(batch, out, rows, ground)

    def write(
        self,
        batch: b.Batch,
        out: NDArray[np.float32],
        rows: NDArray[np.int64],
        ground: Ground | None,
    ) -> None:
        """Write what is seen of `rows` now into out (N, D)."""
        if not rows.size:
            return
        out[rows[:, None], self._to] = self.written[rows[:, None], self._from]
        delivered = self._deliver(batch, rows) if self.layout.channels else np.zeros((0, 0))
        count = len(delivered)

        def known(column: int) -> Values:
            if column < count:
                return delivered[column]
            field = column - count
            return self.written[rows, field].astype(np.float64) * obs.SCALE[field]

        names = {name: k for k, name in enumerate((*self.layout.channels, *obs.NAMES))}
        seen = _Named(names, known)
        for group in self.layout.parts:
            if group.name in obs.V0.groups:
                continue
            values: Mapping[str, Any] = seen if group.values is None else group.values(seen)
            if group.name in self._scans:
                heights = self._scans[group.name].read(batch, rows, ground)
                values = {f.name: heights[:, k] for k, f in enumerate(group.fields)}
            columns = self._columns[group.name]
            shown = np.empty((rows.size, len(columns)))
            for k, field in enumerate(group.fields):
                shown[:, k] = _checked(group.name, values, field.name, rows.size)
            bound = self._bound[columns]
            out[rows[:, None], columns] = np.clip(shown / self._scale[columns], -bound, bound)

    def _deliver(self, batch: b.Batch, rows: NDArray[np.int64]) -> Values:
        """The samples of the registered channels that have arrived, (channels, rows)."""
        floats, counters = batch.floats, batch.counters
        steps, slots = counters[rows, b.STEP], self._past.shape[1]
        for i in rows[steps % NOISE_BLOCK == 0]:
            for k, stream in enumerate(self._streams[i]):
                self._noise[i, k] = stream.standard_normal(NOISE_BLOCK)
        truth = _Named(_TRUE, lambda column: floats[rows, column])
        exact = np.empty((rows.size, len(self._clocks)))
        for k, name in enumerate(self.layout.channels):
            of_truth = ADDED[name].truth
            assert of_truth is not None
            exact[:, k] = _checked("truth", {name: of_truth(truth)}, name, rows.size)
        each, now = rows[:, None], steps[:, None]
        noise = self._noise[rows, :, steps % NOISE_BLOCK]
        measured = exact + self._bias[rows] + self._sigma[rows] * noise
        fresh = floats[each, b.SAMPLE + CHANNEL_COUNT + self._clocks] == now
        sample = np.where(fresh, measured, self._sample[rows])
        self._sample[rows] = sample
        self._past[rows, steps % slots] = sample
        past = np.maximum(now - counters[each, b.DELAY + self._clocks], 0)
        delivered: Values = self._past[each, past % slots, np.arange(exact.shape[1])].T
        return delivered


def _checked(source: str, values: Mapping[str, Any], name: str, count: int) -> Values:
    """One of `values`, () or (count,). Raises ValueError where it is missing or misshapen."""
    if name not in values:
        raise ValueError(f"{source}: no value of {name!r}; there are {sorted(values)}")
    value = np.asarray(values[name], dtype=np.float64)
    if value.shape not in ((), (count,)):
        raise ValueError(f"{source} of {name!r} has shape {value.shape}; must be ({count},)")
    return value
