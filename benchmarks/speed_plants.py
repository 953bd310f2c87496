"""Plants without an environment, for rows of the speed table: (what is repeated, what precedes it).

The light vehicle with 2 x 40 patches turns under its own belts. Terrain: one step of 1 ms, as
published simulators take it, and what counts to a user, 20 ms of driving at the default step.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

STEPS = 1000  # of one call: its overhead is below a percent
CONTROL_PERIOD = 0.02  # [s]
_RNG = np.random.default_rng(0)
_WAVES = np.column_stack(
    [_RNG.uniform(0.01, 0.05, 8), _RNG.uniform(-2.0, 2.0, (8, 2)), _RNG.uniform(0.0, 6.0, 8)]
)
_EAST, _NORTH = np.meshgrid(np.linspace(-40.0, 40.0, 801), np.linspace(-40.0, 40.0, 801))
GROUNDS: dict[str, dict[str, Any]] = {
    "plane": {"kind": "plane", "slope_x": 0.1},
    "ramp": {"kind": "ramp", "slope": 0.1, "start": 0.8, "length": 4.0},
    "height map": {
        "kind": "map", "cell": 0.1, "heights": 0.2 * np.sin(0.5 * _EAST) * np.cos(0.4 * _NORTH),
    },
    "8 sinusoids": {"kind": "waves", "waves": _WAVES.tolist()},
}  # fmt: skip
Calls = tuple[Callable[[], object], Callable[[], object]]


def _speeds(count: int) -> Any:
    """Sprocket speeds (N, 2) [rad/s] that turn each vehicle on a circle of its own."""
    return np.linspace((3.0, 4.0), (4.0, 8.0), count)


def distributed_alone(count: int, euler: bool) -> Calls:
    """STEPS steps of the distributed plant.

    Euler steps of 1 ms cost one evaluation of all patches each; Rosenbrock steps of 2.5 ms, the
    default, cost two.
    """
    from tracked_env.physics.parameters import VEHICLES
    from tracked_env.physics.patches_on_level_ground import hold_speeds, make_patches

    states, loads, speeds = np.zeros((count, 6)), np.zeros((count, 6)), _speeds(count)
    parameters = np.tile(np.array(VEHICLES["focchi"], dtype=float), (count, 1))
    patches, h = make_patches(10, 4), 1e-3 if euler else 2.5e-3
    return (
        lambda: hold_speeds(states, speeds, parameters, patches, STEPS, h, euler, loads),
        lambda: None,
    )


def terrain_alone(count: int, ground: str, step: float | None) -> Calls:
    """STEPS steps of the plant on terrain, of that length [s].

    None: as many control periods at its default step.
    """
    from tracked_env.physics.parameters import VEHICLES
    from tracked_env.plants.standalone import TerrainRig
    from tracked_env.plants.terrain import LONGEST_STEP

    rig = TerrainRig(
        VEHICLES["focchi"], {"terrain": GROUNDS[ground]}, count, step=step or LONGEST_STEP
    )
    speeds, duration = _speeds(count), STEPS * (step or CONTROL_PERIOD)

    def stand() -> None:
        for row in range(count):
            rig.stand(0.0, 0.0, 0.1 * row, row)

    return lambda: rig.advance(speeds, duration), stand
