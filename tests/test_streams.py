"""Random numbers drawn in kernels: those of NumPy's generators, and the noise of sensors."""

import numpy as np
import pytest

from tracked_env import arrays as b
from tracked_env import streams
from tracked_env.physics.jit import loop
from tracked_env.sensors import NOISE_COUNT

SEEDS = (0, 1, 7, 2**31, 2**32 - 1, 2**32, 2**32 + 1, 2**62 + 12345, 2**63 - 1)
COUNTS = (1, 2, 3, 7, 2**31 + 11, 2**32 - 5)  # the last two reject a share of the draws


@loop
def draw(rng, floats, integers, counts):
    """All kinds of numbers in turn, as a law takes them."""
    for k in range(floats.shape[0]):
        floats[k, 0] = streams.random(rng)
        for j in range(counts.size):
            integers[k, j] = streams.integer(rng, counts[j])
        floats[k, 1] = streams.uniform(rng, -3.7, 1.9)
        integers[k, counts.size] = streams.seed(rng)


@pytest.mark.parametrize("kind", ["PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64"])
def test_numbers_are_those_of_the_generators_methods_and_it_moves_on(kind):
    one, other = (np.random.Generator(getattr(np.random, kind)(5)) for _ in range(2))
    floats, integers = np.empty((2000, 2)), np.empty((2000, len(COUNTS) + 1), dtype=np.int64)
    (address,) = streams.addresses([one])
    draw(address, floats, integers, np.array(COUNTS))
    for real, whole in zip(floats, integers, strict=True):
        assert real[0] == other.random()
        assert whole[:-1].tolist() == [other.integers(count) for count in COUNTS]
        assert real[1] == other.uniform(-3.7, 1.9)
        assert whole[-1] == other.integers(2**63)
    assert one.integers(5) == other.integers(5)  # the unused half of a number is still there
    assert one.random() == other.random()


def seeded(seed):
    """The state of one vehicle."""
    state = np.zeros(streams.STATE, dtype=np.uint64)
    streams.seed_state(state, seed)
    return state


@pytest.mark.parametrize("seed", SEEDS)
def test_a_seed_gives_the_state_that_numpys_sfc64_has_of_it(seed):
    expected = np.random.SFC64(seed).state["state"]["state"]
    assert np.array_equal(seeded(seed)[:4], expected)


@pytest.mark.parametrize("seed", SEEDS)
def test_normal_numbers_equal_numpys_bit_for_bit_in_the_tail_and_in_the_wedges_too(seed):
    state, draws = seeded(seed), np.empty(1_500_000, dtype=np.float32)
    streams.fill_normal(state, draws[None])
    generator = np.random.Generator(np.random.SFC64(seed))
    expected = generator.standard_normal(draws.size, dtype=np.float32)
    assert np.array_equal(draws.view(np.uint32), expected.view(np.uint32))  # also the sign of 0
    assert np.sum(np.abs(expected) > streams.TAIL) > 200  # the tail has been visited: 2.6e-4 of all
    assert np.array_equal(state[:4], generator.bit_generator.state["state"]["state"])


def test_draws_in_pieces_of_any_length_are_those_in_one_piece():
    whole, pieces = np.empty(10_000, np.float32), np.empty(10_000, np.float32)
    streams.fill_normal(seeded(3), whole[None])
    state = seeded(3)
    for part in np.split(pieces, [1, 2, 5, 964, 965, 4321]):  # odd: half a number is left over
        streams.fill_normal(state, part[None])
    assert np.array_equal(whole, pieces)


def test_a_block_has_the_order_of_numpys_array_of_runs_steps_and_channels():
    runs = b.NOISE_BLOCK // b.NOISE_RUN
    block = np.zeros((runs, 3, b.NOISE_RUN, NOISE_COUNT), dtype=np.float32)
    states = np.stack([seeded(seed) for seed in range(3)])
    generator = np.random.Generator(np.random.SFC64(1))
    for _ in range(2):
        streams.draw_block(block, states, 1)
        expected = generator.standard_normal((runs, b.NOISE_RUN, NOISE_COUNT), dtype=np.float32)
        assert np.array_equal(block[:, 1], expected)
    assert not block[:, [0, 2]].any()


def test_a_refill_touches_only_chosen_vehicles_at_the_end_of_their_block():
    batch, last = b.allocate(4, 1), b.NOISE_BLOCK - 1
    counters = batch.counters
    counters[:, b.NOISE_CURSOR] = last, last - 1, last, last
    states = np.stack([seeded(seed) for seed in range(4)])
    noisy = np.array([True, True, True, False])
    left = streams.refill(batch, states, noisy, np.array([0, 1, 3]))
    assert counters[:, b.NOISE_CURSOR].tolist() == [-1, last - 1, last, -1]
    assert batch.noise.any(axis=(0, 2, 3)).tolist() == [True, False, False, False]
    assert left == 1  # of the vehicle that was one step before the end
    again = (batch, states, noisy)
    assert streams.refill(*again, np.array([0, 3])) == b.NOISE_BLOCK
    counters[3, b.NOISE_CURSOR] = 5
    assert streams.refill(*again, np.array([0, 3])) == last - 5
