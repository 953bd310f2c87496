"""Sensor noise drawn in kernels: the numbers of NumPy's generator, and what they cost."""

import numpy as np
import pytest

from tracked_env import arrays as b
from tracked_env.engine import noise
from tracked_env.sensors import NOISE_COUNT

SEEDS = (0, 1, 7, 2**31, 2**32 - 1, 2**32, 2**32 + 1, 2**62 + 12345, 2**63 - 1)


def seeded(seed):
    """The state of one vehicle."""
    state = np.zeros(noise.STATE, dtype=np.uint64)
    noise.seed_state(state, seed)
    return state


@pytest.mark.parametrize("seed", SEEDS)
def test_a_seed_gives_the_state_that_numpys_sfc64_has_of_it(seed):
    expected = np.random.SFC64(seed).state["state"]["state"]
    assert np.array_equal(seeded(seed)[:4], expected)


@pytest.mark.parametrize("seed", SEEDS)
def test_normal_numbers_equal_numpys_bit_for_bit_in_the_tail_and_in_the_wedges_too(seed):
    state, drawn = seeded(seed), np.empty(1_500_000, dtype=np.float32)
    noise.fill_normal(state, drawn)
    generator = np.random.Generator(np.random.SFC64(seed))
    expected = generator.standard_normal(drawn.size, dtype=np.float32)
    assert np.array_equal(drawn.view(np.uint32), expected.view(np.uint32))  # also the sign of 0
    assert np.sum(np.abs(expected) > noise.TAIL) > 200  # the tail has been visited: 2.6e-4 of all
    assert np.array_equal(state[:4], generator.bit_generator.state["state"]["state"])


def test_draws_in_pieces_of_any_length_are_those_in_one_piece():
    whole, pieces = np.empty(10_000, np.float32), np.empty(10_000, np.float32)
    noise.fill_normal(seeded(3), whole)
    state = seeded(3)
    for part in np.split(pieces, [1, 2, 5, 964, 965, 4321]):  # odd: half a number is left over
        noise.fill_normal(state, part)
    assert np.array_equal(whole, pieces)


def test_a_block_has_the_order_of_numpys_array_of_runs_steps_and_channels():
    runs = b.NOISE_BLOCK // b.NOISE_RUN
    block = np.zeros((runs, 3, b.NOISE_RUN, NOISE_COUNT), dtype=np.float32)
    states = np.stack([seeded(seed) for seed in range(3)])
    generator = np.random.Generator(np.random.SFC64(1))
    for _ in range(2):
        noise.draw_block(block, states, 1)
        expected = generator.standard_normal((runs, b.NOISE_RUN, NOISE_COUNT), dtype=np.float32)
        assert np.array_equal(block[:, 1], expected)
    assert not block[:, [0, 2]].any()


def test_a_refill_touches_only_chosen_vehicles_at_the_end_of_their_block():
    counters = np.zeros((4, b.COUNTER_COLUMNS), dtype=np.int64)
    last = b.NOISE_BLOCK - 1
    counters[:, b.NOISE_CURSOR] = last, last - 1, last, last
    block = np.zeros((b.NOISE_BLOCK // b.NOISE_RUN, 4, b.NOISE_RUN, NOISE_COUNT), np.float32)
    states = np.stack([seeded(seed) for seed in range(4)])
    noisy = np.array([True, True, True, False])
    left = noise.refill(block, counters, states, noisy, np.array([0, 1, 3]))
    assert counters[:, b.NOISE_CURSOR].tolist() == [-1, last - 1, last, -1]
    assert block.any(axis=(0, 2, 3)).tolist() == [True, False, False, False]
    assert left == 1  # of the vehicle that was one step before the end
    again = (block, counters, states, noisy)
    assert noise.refill(*again, np.array([0, 3])) == b.NOISE_BLOCK
    counters[3, b.NOISE_CURSOR] = 5
    assert noise.refill(*again, np.array([0, 3])) == last - 5
