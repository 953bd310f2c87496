"""Random numbers drawn in kernels from NumPy's generators: the numbers of their methods."""

import numpy as np
import pytest

from tracked_env.engine import noise
from tracked_env.physics.jit import loop

COUNTS = (1, 2, 3, 7, 2**31 + 11, 2**32 - 5)  # the last two reject a share of the draws


@loop
def draw(rng, floats, integers, counts):
    """All kinds of numbers in turn, as a law takes them."""
    for k in range(floats.shape[0]):
        floats[k, 0] = noise.random(rng)
        for j in range(counts.size):
            integers[k, j] = noise.integer(rng, counts[j])
        floats[k, 1] = noise.uniform(rng, -3.7, 1.9)
        integers[k, counts.size] = noise.seed(rng)


@pytest.mark.parametrize("kind", ["PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64"])
def test_numbers_are_those_of_the_generators_methods_and_it_moves_on(kind):
    one, other = (np.random.Generator(getattr(np.random, kind)(5)) for _ in range(2))
    floats, integers = np.empty((2000, 2)), np.empty((2000, len(COUNTS) + 1), dtype=np.int64)
    (address,) = noise.addresses([one])
    draw(address, floats, integers, np.array(COUNTS))
    for real, whole in zip(floats, integers, strict=True):
        assert real[0] == other.random()
        assert whole[:-1].tolist() == [other.integers(count) for count in COUNTS]
        assert real[1] == other.uniform(-3.7, 1.9)
        assert whole[-1] == other.integers(2**63)
    assert one.integers(5) == other.integers(5)  # the unused half of a number is still there
    assert one.random() == other.random()
