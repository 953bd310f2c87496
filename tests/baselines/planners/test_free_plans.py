"""Plans among obstacles against an oracle of its own: none touches, and ways that exist are taken.

The motion is sampled anew, every few milliseconds, whatever period the plan was made with.
"""

import math

import numpy as np
import pytest

from baselines.planners.clearance import Footprint
from baselines.planners.obstacles import Obstacles
from baselines.planners.plan import plan
from baselines.planners.trajectory import Limits
from baselines.slip.slip_sweep import identified_slip, identified_slope_slip
from tests.baselines.planners.scenes import (
    bar,
    cells_of,
    least_distance,
    poses_of,
    random_scene,
)
from tracked_env.physics.parameters import VEHICLES

FOCCHI, STRAWA = VEHICLES["focchi"], VEHICLES["strawa"]
MARGIN = 0.05
RESTING = Limits.of(FOCCHI, reserve=0.1, sprocket_acceleration=20.0)
SPOT = Limits.of(FOCCHI, v_min=0.0, reserve=0.1)
FAST = Limits.of(STRAWA, v_min=0.5, v_max=2.0)
SLIP = {"slip_model": identified_slip(FOCCHI)}
# Name, vehicle, limits, arguments, share of the scenes below that must get a plan.
CASES = [
    ("dubins", FOCCHI, Limits.of(FOCCHI, v_min=0.4, v_max=0.4), {"method": "dubins"}, 0.75),
    ("reeds-shepp", FOCCHI, Limits.of(FOCCHI), {"method": "reeds-shepp"}, 0.9),
    ("clothoid", FOCCHI, Limits.of(FOCCHI, v_min=0.0), {"method": "clothoid"}, 0.75),
    ("fixed", FOCCHI, Limits.of(FOCCHI, v_min=0.4, v_max=0.4, reserve=0.1), SLIP, 0.7),
    ("to rest", FOCCHI, RESTING, SLIP, 0.7),
    ("both gears", FOCCHI, RESTING, {**SLIP, "reverse": True}, 0.9),
    ("on the spot", FOCCHI, SPOT, SLIP, 0.9),
    ("large", STRAWA, FAST, {"method": "dubins"}, 0.75),
    ("large, both gears", STRAWA, FAST._replace(v_min=0.2), {"reverse": True}, 0.9),
]


def motion_is_free(arguments, scene, box, margin=MARGIN):
    """The plan, its motion sampled every 4 ms, and that this keeps the margin all along."""
    made = plan(**arguments)
    if made.converged:
        fine = plan(**{**arguments, "period": 0.004, "time_limit": 60.0})
        assert fine.converged
        for poses in (poses_of(made), poses_of(fine)):
            assert least_distance(poses, box, scene[0], scene[1]) > margin
        goal = np.asarray(arguments["goal"], dtype=float)
        assert math.hypot(made.x[-1] - goal[0], made.y[-1] - goal[1]) < 1e-3
        assert abs(math.remainder(made.yaw[-1] - goal[2], 2.0 * math.pi)) < 0.3
    return made


def random_scenes_are_free(case, seeds):
    """Share of scenes with a plan."""
    _, vehicle, limits, more, _ = case
    box = Footprint.of(vehicle)
    size, converged = 5.0 * box.radius, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        goal = np.array([*rng.uniform(-1.2, 1.2, 2) * size, rng.uniform(-3, 3)])
        scene = random_scene(rng, box, (0, 0, 0), goal, size, MARGIN)
        made = motion_is_free(
            {
                "start": (0, 0, 0), "goal": goal, "limits": limits, "vehicle": vehicle,
                "obstacles": scene.obstacles, "period": rng.choice([0.02, 0.3, 10.0]),
                "time_limit": 1.0, **more,
            },
            scene, box,
        )  # fmt: skip
        converged += made.converged
    return converged / len(seeds)


@pytest.mark.parametrize("case", CASES, ids=[case[0] for case in CASES])
def test_no_plan_of_any_kind_touches_anything(case):
    assert random_scenes_are_free(case, range(2000, 2008)) > 0.4


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=[case[0] for case in CASES])
def test_no_plan_of_any_kind_touches_anything_in_many_scenes(case):
    assert random_scenes_are_free(case, range(3000, 3060)) >= case[-1]


TRAP = [bar(1.5, 0, np.pi / 2, 3, 0.1), bar(0.5, 1.5, 0, 2, 0.1), bar(0.5, -1.5, 0, 2, 0.1)]
GARAGE = [bar(0.1, 0.75, 0, 1.4, 0.1), bar(0.1, -0.75, 0, 1.4, 0.1), bar(0.75, 0, 1.5708, 1.6, 0.1)]
BEND = [
    bar(2, 0.6, 0, 4, 0.05), bar(2.5, -0.6, 0, 5, 0.05), bar(5.05, 1.2, np.pi / 2, 3.6, 0.05),
    bar(4.0, 2, np.pi / 2, 2.75, 0.05),
]  # fmt: skip
PARKED = [bar(1.0, -0.95, 0, 0.8, 0.7), bar(3.2, -0.95, 0, 0.8, 0.7), bar(2, -1.55, 0, 5, 0.1)]
FAR = Limits.of(STRAWA, v_min=0.5, v_max=3.0)
SCENES = {
    "a wall of 4 m before a goal at 12 m": (
        (0, 0, 0), (12, 0, 0), [bar(6, 0, np.pi / 2, 4, 0.2)], {}),
    "a wall of 8 m": ((0, 0, 0), (12, 0, 0), [bar(6, 0, np.pi / 2, 8, 0.2)], {}),
    "out of a garage in reverse": ((0, 0, 0), (3, 0, 0), GARAGE, {"reverse": True}),
    "out of a garage, turning in it": ((0, 0, 0), (3, 0, 0), GARAGE, {"limits": SPOT}),
    "out of a garage, Reeds-Shepp": ((0, 0, 0), (3, 0, 0), GARAGE, {"method": "reeds-shepp"}),
    "out of a trap": ((0, 0, 0), (4, 0, 0), TRAP, {"reverse": True}),
    "a corridor with a bend": ((0, 0, 0), (4.5, 3.5, np.pi / 2), BEND, {}),
    "a thin wall behind": ((0, 0, 0), (-3, 0, 0), [bar(-1.5, 0, np.pi / 2, 2, 1e-4)], {}),
    "parallel parking": ((2.1, 0.4, 0), (2.1, -0.95, 0), PARKED, {"reverse": True}),
    "200 m": (
        (0, 0, 0), (200, 0, 0), [bar(100, 0, np.pi / 2, 20, 0.1)],
        {"vehicle": STRAWA, "limits": FAR}),
    "touching walls": (
        (0, 0, 0), (4, 0, 0), [bar(2, y, np.pi / 2, 1, 0.1) for y in (-1.0, 0.0, 1.0)], {}),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_a_way_that_exists_is_taken(name):
    start, goal, walls, more = SCENES[name]
    arguments = {"start": start, "goal": goal, "limits": RESTING, "vehicle": FOCCHI, **more}
    box = Footprint.of(arguments["vehicle"])
    scene = (), walls
    made = motion_is_free({**arguments, "obstacles": Obstacles.of(polygons=walls)}, scene, box)
    assert made.converged, made.message


def test_a_bulldozer_goes_round_cells_of_5_cm_in_a_turned_map_with_its_own_footprint():
    rng = np.random.default_rng(3)
    occupied = rng.random((800, 800)) < 4e-5
    origin, box = (-12.0, -20.0, 0.3), (3.5, 2.0, 1.6, 1.6)
    squares = cells_of(occupied, 0.05, origin)
    goal = (14.0, 3.0, 0.5)
    near = least_distance(np.array([(0, 0, 0), goal], dtype=float), box, convex=squares)
    assert near > 0.3
    obstacles = Obstacles.of(occupied=occupied, cell=0.05, origin=origin)
    made = motion_is_free(
        {
            "start": (0, 0, 0), "goal": goal, "limits": FAST, "vehicle": STRAWA, "margin": 0.2,
            "obstacles": obstacles, "footprint": box, "method": "reeds-shepp", "period": 1.0,
        },
        ((), squares), box, 0.2,
    )  # fmt: skip
    assert made.converged, made.message


@pytest.mark.slow
def test_plans_on_a_slope_keep_their_margin():
    slip = identified_slope_slip(FOCCHI, speed_step=2.5, slope_step=0.21875)
    wall = bar(1.5, -0.5, np.pi / 2, 2.0, 0.1)
    made = motion_is_free(
        {
            "start": (0, 0, 0), "goal": (3, 0, 0), "limits": Limits.of(FOCCHI, reserve=0.1),
            "slip_model": slip, "ground": (0.1, 0.05), "obstacles": Obstacles.of(polygons=[wall]),
        },
        ((), [wall]), Footprint.of(FOCCHI),
    )  # fmt: skip
    assert made.converged, made.message


def test_samples_far_apart_are_of_the_same_motion():
    wall = bar(1.6, -0.25, np.pi / 2, 3.5, 0.2)
    task = {"obstacles": Obstacles.of(polygons=[wall]), "method": "dubins"}
    coarse = plan((0, 0, 0), (3.5, 0, 0), RESTING, period=10.0, **task)
    fine = plan((0, 0, 0), (3.5, 0, 0), RESTING, period=0.02, **task)
    assert len(coarse.time) == 2 + int(coarse.duration / 10.0)
    assert coarse.duration == pytest.approx(fine.duration)
    for column in ("x", "y", "yaw"):
        at = np.interp(coarse.time, fine.time, getattr(fine, column))
        assert getattr(coarse, column) == pytest.approx(at, abs=1e-6)
