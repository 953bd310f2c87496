"""Sensor channels that are sampled where an observation shows them: attitude, registered ones.

A channel is sampled whenever its group is, in the same steps and with the same delay:
    sample = truth + s b + sigma n,    n ~ N(0, 1),  s = -1 or +1 for the episode
from a stream of its own, seeded by the noise seed of the episode and the name of the channel: what
an environment shows never changes the other noise, the vehicle, the soil or the reference. The
attitude's true values are computed in the kernel (`physics.channels.attitude_signals`), those of
registered channels by the function that they carry.
"""

import zlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.engine.episode import Episode
from tracked_env.physics import channels
from tracked_env.physics.channels import ATTITUDE, CHANNEL_COUNT, GROUPS
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX
from tracked_env.physics.state import STATE_NAMES
from tracked_env.sensor_draws import longest_delay_steps
from tracked_env.sensors import ADDED

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
        attitude = channels.attitude_signals(floats, i)
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
