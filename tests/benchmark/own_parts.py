"""A vehicle, rewards and a kind of reference of a project; other processes import it by name."""

import numpy as np

from tracked_env import references, register_vehicle, rewards
from tracked_env.references import ReferenceProfile, constant, number_of_segments


def creep(duration: float, speed: float = 0.5) -> ReferenceProfile:
    """Straight on, slowly."""
    count = number_of_segments(duration)
    return ReferenceProfile(constant(speed, count), constant(0.0, count))


def near(step: rewards.Outcome) -> np.ndarray:
    """The distance to the reference, negative."""
    return -step.distance


references.register("creep", creep)
rewards.register("near", near)
rewards.register("sharp", {"position": {"scale": 0.02}})
register_vehicle("crawler", {"base": "focchi", "mass": 50.0})
