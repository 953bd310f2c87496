"""Runs of the adaptive policy with what its observer believes, for the observer's figures."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import adaptive
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.engine.columns import columns
from tracked_env.physics.state import STATE_NAMES

Floats = NDArray[np.float64]
SEED = 72_000  # episodes on which nothing was chosen
PARAMETERS = ("mass", "inertia", "longitudinal_resistance", "lateral_resistance")


class Run(NamedTuple):
    """Beliefs and truth of N vehicles over T control steps; parameters as in PARAMETERS."""

    period: float  # [s]
    value: Floats  # (T, N, 4) SI
    deviation: Floats  # (T, N, 4)
    truth: Floats  # (T, N, 4)
    state: Floats  # (T, N, STATE_ROWS) true, columns as STATE_NAMES
    status: NDArray[np.int64]  # (T, N, 2) of the regressions: longitudinal, turning
    excitation: Floats  # (T, N, 2)
    policy: AdaptivePolicy

    @property
    def time(self) -> Floats:
        """(T,) [s]."""
        return self.period * np.arange(len(self.value))

    def error(self, name: str) -> Floats:
        """(T, N) relative error of one parameter."""
        j = PARAMETERS.index(name)
        return self.value[..., j] / self.truth[..., j] - 1.0

    def claimed(self, name: str) -> Floats:
        """(T, N) claimed deviation of one parameter over its true value."""
        j = PARAMETERS.index(name)
        return self.deviation[..., j] / self.truth[..., j]

    def motion(self, name: str) -> Floats:
        """(T, N) one state of the vehicle."""
        return self.state[..., STATE_NAMES.index(name)]


def driven(name: str, count: int, reset: Mapping[str, Any] | None = None, **changed: Any) -> Run:
    """Drive `count` episodes of an evaluation set; changed: of `BenchmarkConfig`."""
    config = BenchmarkConfig(sets=(name,), episodes=count, **changed)
    env, policy = config.environment(name, count, truth=False), adaptive(config.context(name))
    assert isinstance(policy, AdaptivePolicy)
    batch, truths, states = env.simulation.batch, columns(PARAMETERS), columns(STATE_NAMES)
    seeds = [SEED + i for i in range(count)]
    observation, _ = env.reset(seed=seeds, options=None if reset is None else dict(reset))
    state: Any = None
    rows: list[tuple[Floats, ...]] = []
    for _ in range(env.simulation.settings.max_steps):
        action, state = policy.predict(observation, state)
        known = policy.known
        told, status, excitation = known.estimates(), known.status(), known.excitation()
        rows.append((
            np.stack([told[p][0] for p in PARAMETERS], axis=1),
            np.stack([told[p][1] for p in PARAMETERS], axis=1),
            batch.floats[:, truths].copy(),
            batch.floats[:, states].copy(),
            np.stack([status[part] for part in ("longitudinal", "turning")], axis=1),
            np.stack([excitation[part] for part in ("longitudinal", "turning")], axis=1),
        ))  # fmt: skip
        observation, *_ = env.step(action)
    parts = [np.array(part) for part in zip(*rows, strict=True)]
    return Run(env.simulation.solver.control_period, *parts, policy)  # type: ignore[arg-type]
