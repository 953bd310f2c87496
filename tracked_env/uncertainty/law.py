"""What a law of uncertainty is: it draws the truth of one episode around nominal parameters."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tracked_env.events import Event
from tracked_env.physics.parameters import PlantParameters
from tracked_env.references import ReferenceProfile


class Draw(NamedTuple):
    """The truth of one episode."""

    parameters: PlantParameters
    events: list[Event]


# (random stream, nominal parameters, reference, duration [s]) -> truth
Law = Callable[[np.random.Generator, PlantParameters, ReferenceProfile, float], Draw]
