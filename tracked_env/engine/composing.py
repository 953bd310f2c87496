"""Observations of other groups than the compiled loops write, and registered sensor channels.

The kernels write the fields of `observation.V0`, which `Composer` picks from and adds to. It runs
only where the layout of an environment is another one: channels are sampled (`added_channels`),
computed groups get what they read, and one kernel writes all fields, scaled and clipped. A group
that is computed by a function in Python costs 10 us and more a step, a compiled one 1 us.
"""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env import observation as obs
from tracked_env.engine import columns as b
from tracked_env.engine.added_channels import AddedChannels, Named, Values, checked
from tracked_env.engine.episode import Episode
from tracked_env.engine.goal_reading import read_goal
from tracked_env.engine.height_scan import HeightScan
from tracked_env.observation_fields import Group
from tracked_env.physics.jit import loop
from tracked_env.plants import Ground


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
