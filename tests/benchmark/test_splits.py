"""Splits of the seeds: what is published, chosen on and checked on shares no episode."""

from itertools import combinations

import pytest

from agents.folder import HELD_OUT_SEED
from agents.run import ROWS, TRAININGS, random_seed
from tracked_env.benchmark import BenchmarkConfig, frozen
from tracked_env.benchmark.evaluation_sets import (
    AUDIT,
    DEVELOPMENT,
    EPISODES,
    SPLITS,
    VERSIONS,
    seeds_of,
)
from tracked_env.benchmark.runner import episode_digest


def overlap(one: range, other: range) -> bool:
    return max(one.start, other.start) < min(one.stop, other.stop)


def test_no_two_splits_share_a_seed() -> None:
    splits = [seeds_of(name) for name in SPLITS]
    assert not any(overlap(one, other) for one, other in combinations(splits, 2))
    assert [seeds_of(name).start for name in ("development", "audit")] == [DEVELOPMENT, AUDIT]
    assert all(len(split) >= EPISODES for split in splits)


def test_trainings_and_their_held_out_episodes_have_seeds_of_no_split() -> None:
    held_out = range(HELD_OUT_SEED, HELD_OUT_SEED + ROWS)
    trainings = range(random_seed(0), random_seed(TRAININGS - 1) + ROWS)
    assert not overlap(held_out, trainings)
    for name in SPLITS:
        assert not overlap(seeds_of(name), held_out)
        assert not overlap(seeds_of(name), trainings)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_published_episodes_lie_in_the_frozen_split(version: str) -> None:
    """As the kept file of the version says, not the constants of the program."""
    document = frozen.kept(VERSIONS[version])
    published = range(document["seed"], document["seed"] + document["episodes"])
    assert published.start == seeds_of("frozen").start
    assert published.stop <= seeds_of("frozen").stop


def test_the_same_set_draws_other_episodes_in_every_split() -> None:
    env = BenchmarkConfig(sets=("mixed",)).environment("mixed", 3, truth=False)
    digests = set()
    for first in SPLITS.values():
        env.reset(seed=first)
        digests |= {episode_digest(one) for one in env.simulation.episodes if one is not None}
    env.close()
    assert len(digests) == 3 * len(SPLITS)


def test_an_unknown_split_is_refused_with_those_that_exist() -> None:
    with pytest.raises(ValueError, match=r"unknown split of seeds 'develop'.*Did you mean"):
        seeds_of("develop")
