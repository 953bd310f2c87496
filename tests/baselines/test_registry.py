"""Registered controllers: what the centred ones are told."""

import numpy as np
import pytest

from baselines.registry import CENTRE, POLICIES
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT, SETS, TORQUE_SETS
from tracked_env.physics.parameters import PARAMETER_INDEX, PARAMETER_NAMES, VEHICLES

STRAWA = VEHICLES["strawa"]


def test_the_centre_is_the_median_of_what_the_sets_draw_over_all_their_time():
    seconds, drawn = np.arange(30.0), []
    for name in TORQUE_SETS.sets:
        config = BenchmarkConfig(sets=(name,), seed=DEVELOPMENT)
        env = config.environment(name, 60, truth=False)
        env.reset(seed=[config.first_seed(name) + i for i in range(60)])
        for episode in env.simulation.episodes:
            values = np.tile(np.array(episode.parameters), (len(seconds), 1))
            for row in episode.events:  # a line on the ground is taken as crossed halfway
                start = row[3] if row[0] == 0.0 else 15.0
                values[seconds >= start, int(row[1])] = row[2]
            drawn.append(values)
    assert SETS[TORQUE_SETS.sets[0]].arguments.get("vehicle", "strawa") == "strawa"
    middle = np.median(np.concatenate(drawn), axis=0)
    for name in PARAMETER_NAMES[:15]:
        ratio = middle[PARAMETER_INDEX[name]] / getattr(STRAWA, name)
        assert ratio == pytest.approx(CENTRE.get(name, 1.0), rel=0.12), name


@pytest.mark.parametrize("name", ["nominal", "integral"])
def test_the_centred_controllers_are_the_others_told_the_centre(name):
    context = BenchmarkConfig(sets=("mixed",)).context("mixed")
    told = STRAWA._replace(**{n: getattr(STRAWA, n) * factor for n, factor in CENTRE.items()})
    usual = POLICIES[name](context._replace(vehicle=told))
    centred, other = POLICIES[f"{name}-centred"](context), POLICIES[name](context)
    rng = np.random.default_rng(0)
    size = len(context.observation)
    for step in range(5):
        seen = rng.uniform(-0.5, 0.5, (3, size)).astype(np.float32)
        start = np.full(3, step == 0)
        actions = [p.predict(seen, None, start)[0] for p in (usual, centred, other)]
        assert np.array_equal(actions[0], actions[1])
        assert not np.array_equal(actions[1], actions[2])
