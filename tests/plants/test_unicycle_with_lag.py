"""A plant that lives in this file alone drives everything: a kinematic unicycle with a lag.

d omega/dt = (demand - omega) / T,  v = r (omega_L + omega_R) / 2,  w = r (omega_R - omega_L) / B
"""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.benchmark.stub_policies import Constant, entry
from tests.driving import STILL
from tracked_env import SPEED_ID, TORQUE_ID, plants
from tracked_env import arrays as b
from tracked_env.benchmark import SETS, BenchmarkConfig, BenchmarkSet, Store, run
from tracked_env.observation import unpack
from tracked_env.physics import lumped
from tracked_env.physics import parameters as s
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import VEHICLES, row_parameters
from tracked_env.plants import Plant, Prepared
from tracked_env.plants.distributed import rolling
from tracked_env.plants.standalone import Rig
from tracked_env.step import advance_blocks, hold_blocks

DECAY = b.PLANT  # [-] what the lag leaves of a difference after one sub-step
RADIUS, GAUGE = "sprocket_radius", "track_gauge"
LIMIT, LAG = "sprocket_speed_limit", "drive_time_constant"


@formula
def derive(floats, i, substep):
    """Refresh the decay of vehicle i."""
    p = row_parameters(floats, i, b.PARAMETERS)
    floats[i, DECAY] = lumped.torque_decay(substep, p.drive_time_constant)


@formula
def demands(floats, i, p, commands):
    """Sprocket speeds [rad/s] that are commanded, or else that the action asks for."""
    if commands.shape[1] > 0:
        return commands[i, 0], commands[i, 1]
    limit = p.sprocket_speed_limit
    return limit * floats[i, b.ACTION], limit * floats[i, b.ACTION + 1]


@formula
def move(batch, scratch, block, pace, options):
    """Advance and settle the vehicle of a block."""
    floats, i = batch.floats, block.vehicles[block.first]
    p = row_parameters(floats, i, b.PARAMETERS)
    left, right = floats[i, s.SPROCKET_SPEED_LEFT], floats[i, s.SPROCKET_SPEED_RIGHT]
    to_left, to_right = demands(floats, i, p, options[0]) if pace.substeps > 0 else (left, right)
    for _ in range(pace.substeps):
        left = to_left + floats[i, DECAY] * (left - to_left)
        right = to_right + floats[i, DECAY] * (right - to_right)
        speed = 0.5 * p.sprocket_radius * (left + right)
        turn = pace.h * p.sprocket_radius * (right - left) / p.track_gauge
        cosine, sine = rotation(floats[i, s.YAW] + 0.5 * turn)
        floats[i, s.X] += pace.h * speed * cosine
        floats[i, s.Y] += pace.h * speed * sine
        floats[i, s.YAW] += turn
    speed = 0.5 * p.sprocket_radius * (left + right)
    yaw_rate = p.sprocket_radius * (right - left) / p.track_gauge
    if pace.substeps > 0:
        floats[i, s.ACCELERATION_X] = (speed - floats[i, s.V_X]) / pace.period
        floats[i, s.YAW_ACCELERATION] = (yaw_rate - floats[i, s.YAW_RATE]) / pace.period
    floats[i, s.ACCELERATION_Y] = speed * yaw_rate
    floats[i, s.V_X], floats[i, s.YAW_RATE] = speed, yaw_rate
    floats[i, s.SPROCKET_SPEED_LEFT], floats[i, s.SPROCKET_SPEED_RIGHT] = left, right


@loop
def advance(batch, rows, clock, options):
    """Kernel of the control step."""
    return advance_blocks(derive, move, 1, np.empty((1, 1)), batch, rows, clock, options)


@loop
def hold(batch, vehicles, pace, options):
    """Kernel of the plant alone."""
    hold_blocks(derive, move, 1, np.empty((1, 1)), batch, vehicles, pace, options)


@loop
def no_resistances(floats, i):
    """Nothing rolls heavily here."""
    return 0.0, 0.0


def prepare(drive, options):
    """Nothing to choose."""
    return Prepared(advance, hold, start=rolling)


UNICYCLE = plants.register(
    Plant(
        name="unicycle-with-lag",
        reads={"speed": frozenset({RADIUS, GAUGE, LIMIT, LAG})},
        prepare=prepare,
        motion_resistances=no_resistances,
        columns=1,
        panel=(RADIUS, GAUGE, LAG),
    )
)
ARGUMENTS = {"plant": UNICYCLE.name, "sensors": "ideal"}
LEFT, RIGHT = 0.2, 0.3


def turned(limit, parameters, duration):
    """Yaw [rad] after a step of the demands (LEFT, RIGHT) from rest."""
    lag = parameters.drive_time_constant
    gone = lag * (1.0 - np.exp(-duration / lag))
    rate = parameters.sprocket_radius * limit * (RIGHT - LEFT) / parameters.track_gauge
    return rate * (duration - gone)


@pytest.mark.filterwarnings("error")
def test_it_is_made_by_name_checked_and_moves_as_its_equations_say():
    env = gymnasium.make(SPEED_ID, **ARGUMENTS, expose_truth=True).unwrapped
    check_env(env, skip_render_check=True)
    options = {"start": STILL, "vehicle": {LAG: 0.3}, "reference": "straight"}
    env.reset(seed=0, options=options)
    for _ in range(100):
        *_, info = env.step(np.array([LEFT, RIGHT], np.float32))
    parameters = VEHICLES["focchi"]._replace(drive_time_constant=0.3)
    expected = turned(parameters.sprocket_speed_limit, parameters, 2.0)
    start = env.simulation.episodes[0].state.yaw
    assert info["truth"]["yaw"] - start == pytest.approx(expected, rel=2e-2)
    assert info["truth"]["z"] == 0.0


def test_a_plant_object_needs_no_name():
    env = gymnasium.make(SPEED_ID, **{**ARGUMENTS, "plant": UNICYCLE}).unwrapped
    env.reset(seed=0)
    assert np.isfinite(env.step(np.zeros(2, np.float32))[0]).all()


def test_its_sensors_and_its_picture_show_its_motion():
    env = gymnasium.make(SPEED_ID, **ARGUMENTS, render_mode="rgb_array").unwrapped
    env.reset(seed=1)
    first = env.render()
    for _ in range(30):
        readings = env.step(np.array([LEFT, RIGHT], np.float32))[0]
    fields, truth = unpack(readings), env.simulation.truth()
    for name in ("v_x", "yaw_rate", "sprocket_speed_left", "acceleration_y"):
        assert fields[name] == pytest.approx(truth[name][0], rel=1e-5)
    assert not np.array_equal(first, env.render())


def test_the_benchmark_drives_it(tmp_path, monkeypatch):
    arguments = {"plant": UNICYCLE.name, "drive": "speed", "vehicle": "focchi"}
    own_set = BenchmarkSet("unicycle", "friction", "mocap", "straight", 1.0, SPEED_ID, arguments)
    monkeypatch.setitem(SETS, "unicycle", own_set)
    config = BenchmarkConfig(sets=("unicycle",), episodes=2, duration=1.0)
    policy = entry("ahead", lambda context: Constant(0.2, 0.2))
    records = run(config, [policy], Store(tmp_path, config.identity()))
    assert [r["ended"] for r in records] == ["time", "time"]
    assert all(np.isfinite(r["tracking_rmse"]) for r in records)


@pytest.mark.parametrize(
    "options",
    [
        {"soil": {"cohesion": 2e3}},
        {"vehicle": {"mass": 50.0}},
        {"schedule": [{"parameter": "friction_angle", "kind": "ramp", "target": 0.2, "start": 0}]},
    ],
)
def test_options_without_effect_on_it_are_refused(options):
    env = gymnasium.make(SPEED_ID, **ARGUMENTS)
    with pytest.raises(
        ValueError, match="unicycle-with-lag plant driven by speed does not read it"
    ):
        env.reset(seed=0, options=options)


def test_a_drive_and_an_option_that_it_does_not_have_are_refused():
    with pytest.raises(ValueError, match='drive = "torque"; needs plant = "lumped" or'):
        gymnasium.make(TORQUE_ID, plant=UNICYCLE)
    with pytest.raises(ValueError, match="unknown plant_options key 'lag'"):
        gymnasium.make(SPEED_ID, **ARGUMENTS, plant_options={"lag": 1.0})


def test_it_is_driven_without_an_environment():
    parameters = VEHICLES["focchi"]._replace(drive_time_constant=0.3)
    rig = Rig(UNICYCLE, parameters, 2, "speed")
    limit = parameters.sprocket_speed_limit
    rig.advance(np.full((2, 2), (LEFT * limit, RIGHT * limit)), 2.0)
    assert rig.state.yaw == pytest.approx(turned(limit, parameters, 2.0), rel=1e-2)


def test_another_plant_of_its_name_is_refused():
    with pytest.raises(ValueError, match="another plant is registered"):
        plants.register(Plant("unicycle-with-lag", {}, prepare, no_resistances))
    assert plants.register(UNICYCLE) is UNICYCLE
