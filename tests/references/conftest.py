"""What the tests of references share: the generator that references are drawn from."""

import numpy as np
import pytest


@pytest.fixture
def rng():
    return np.random.default_rng(7)
