"""Several threads: the shares of the rows, and the bits of one thread through ends and resets."""

import numpy as np
import pytest

from tests.driving import assert_equal
from tracked_env.engine.simulation import Threads
from tracked_env.vector_env import TrackedVehicleVectorEnv

COUNT, STEPS, SEED = 600, 140, 7  # vehicles: enough for threads; steps: two blocks of noise
NARROW = {"error_limit": 0.5}  # [m] so that vehicles end in nearly every step


@pytest.fixture(scope="module")
def actions():
    """Random actions of all steps, (STEPS, COUNT, 2)."""
    return np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, COUNT, 2)).astype(np.float32)


@pytest.mark.parametrize(("size", "lanes"), [(1, 1), (2, 1), (9, 1), (64, 64), (65, 64), (600, 64)])
@pytest.mark.parametrize("count", [2, 3])
def test_shares_hold_every_row_once_and_begin_at_a_block(size, lanes, count):
    threads, shares = Threads(count), []

    def note(first, last):
        shares.append((first, last))
        return last - first

    assert sum(threads.run(note, size, lanes)) == size
    rows = [row for first, last in shares for row in range(first, last)]
    assert sorted(rows) == list(range(size))
    assert all(first % lanes == 0 for first, _ in shares)
    assert len(shares) == min(count, -(-size // lanes))
    threads.close()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("uncertainty", ["soil-and-mass", "mixed"])
def test_two_threads_give_the_bits_of_one_where_random_actions_end_episodes(
    mode, uncertainty, actions, monkeypatch
):
    arguments = {"autoreset_mode": mode, "uncertainty": uncertainty, **NARROW}
    pair = [TrackedVehicleVectorEnv(COUNT, threads=n, **arguments) for n in (1, 2)]
    shared = []  # resets that two threads did
    whole = Threads.run

    def run(self, function, size, lanes=1):
        shared.append(size if lanes == 1 else 0)
        return whole(self, function, size, lanes)

    monkeypatch.setattr(Threads, "run", run)
    assert_equal(*(env.reset(seed=SEED) for env in pair))
    ends = 0
    for action in actions:
        one, two = (env.step(action) for env in pair)
        assert_equal(one[:4], two[:4])
        ends += int(np.sum(one[2] | one[3]))
    first, second = (env.simulation for env in pair)
    assert_equal(tuple(first.batch), tuple(second.batch))
    assert_equal(tuple(first.running), tuple(second.running))
    states = [[rng.bit_generator.state for rng in one.rngs] for one in (first, second)]
    assert states[0] == states[1]
    assert ends > 2 * COUNT
    assert sum(shared) > COUNT + ends // 2  # the first reset, and most of the others
    for env in pair:
        env.close()
