"""The sharper reward: its values, at the end of an episode too."""

import numpy as np
import pytest

from agents.precision import PreciseReward
from tracked_env.vector_env import TrackedVehicleVectorEnv


def vehicles():
    return TrackedVehicleVectorEnv(
        3, uncertainty="payload", duration=0.5, autoreset_mode="SameStep"
    )


def test_the_added_term_is_of_the_true_distance_also_where_an_episode_ends():
    plain, sharp = vehicles(), PreciseReward(vehicles(), 0.1)
    plain.reset(seed=0)
    sharp.reset(seed=0)
    endings = 0
    for _ in range(60):
        action = np.full((3, 2), 0.2, np.float32)
        _, reward, terminated, truncated, info = plain.step(action)
        ended = terminated | truncated
        shown = info["final_info"] if ended.all() else info
        assert ended.all() or not ended.any()
        endings += ended.all()
        distance = shown["tracking_error"][:, 0]
        expected = reward + 1.0 / (1.0 + (distance / 0.1) ** 2)
        np.testing.assert_allclose(sharp.step(action)[1], expected, rtol=1e-12)
    assert endings == 2


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_a_scale_that_is_not_positive_is_a_clear_error(scale):
    with pytest.raises(ValueError, match="must be positive"):
        PreciseReward(vehicles(), scale)
