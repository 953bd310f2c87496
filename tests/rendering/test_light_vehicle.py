"""A light vehicle on patches of a firm floor is drawn as well as a heavy one in clay."""

import numpy as np
import pytest

from tests.rendering.picture_cases import CENTRED, episode, last_picture
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.parameters import VEHICLES
from tracked_env.physics.patches_on_level_ground import make_patches
from tracked_env.rendering import Renderer, canvas, scene, snapshot
from tracked_env.uncertainty import UNCERTAINTY_SETS, Draw

SLOW = {"kind": "straight", "speed": 0.5, "x": 0.0, "y": 0.0, "yaw": 0.0}
FLOOR = {"plant": "distributed", "drive": "speed", "reference": SLOW}
GENTLE = {"start": {**CENTRED, "speed": 0.3}}


def light(vehicle="focchi", **arguments):
    """A light vehicle at the origin, heading east at 0.3 m/s."""
    return episode(GENTLE, vehicle=vehicle, **{**FLOOR, **arguments})


@pytest.fixture
def texts(monkeypatch):
    """What pictures say, as it is written."""
    strings = []
    put = canvas.Sheet.put

    def recorded(self, string, *more, **style):
        strings.append(string)
        return put(self, string, *more, **style)

    monkeypatch.setattr(canvas.Sheet, "put", recorded)
    return strings


def columns_of(picture, colour):
    """Columns [px] of the scene, strips apart, in which that colour occurs."""
    scene = picture[60:580, :640]
    return np.flatnonzero((scene == colour).all(axis=2).any(axis=0))


@pytest.mark.parametrize("vehicle", ["strawa", "focchi", "focchi-short"])
def test_every_vehicle_is_as_long_in_its_picture(vehicle):
    hull = columns_of(last_picture(light(vehicle), 1, 0.0, 0.0), scene.HULL)
    assert 74 <= hull[-1] - hull[0] <= 79


def test_a_zoom_that_does_not_suit_the_vehicle_is_refused_by_name():
    wide, close, none = (Renderer("rgb_array", 50, pixels_per_metre=z) for z in (40, 290, 0))
    focchi = light().simulation
    for drawing in (wide, close, none):
        with pytest.raises(ValueError, match=r"must be an int in \[58, 285\] for a vehicle"):
            drawing.draw(focchi, 0)
    assert close.draw(light("focchi-short").simulation, 0) is not None
    assert wide.draw(episode().simulation, 0) is not None


@pytest.mark.parametrize("zoom", [20, 50, 51, 100, 101, 114, 200, 201, 400])
def test_scale_bar_and_grid_suit_every_zoom(zoom):
    assert 40 <= canvas.scale_bar(zoom) * zoom <= 100
    grid = canvas.grid_of(zoom)
    assert 100 <= grid.side * zoom <= 500
    assert 20 <= grid.side * zoom / grid.parts <= 101


def test_arrows_scale_with_what_the_usual_soil_resists(texts):
    assert canvas.sizes_of(VEHICLES["strawa"]) == (2.0, 0.15e-3, 100.0, 5e3)
    sample = canvas.sizes_of(VEHICLES["focchi"])
    assert (sample.length, sample.force_sample) == (0.7, 50.0)
    assert sample.force_shown == pytest.approx(100.0 * 62.0 * 0.425 / (1450.0 * 1.4))
    env = light()
    picture = last_picture(env, 1, 1.0, 1.0)
    effort = snapshot.take(env.simulation, 0).state.effort_left
    assert 60.0 < effort < 130.0
    green = columns_of(picture, canvas.GREEN)
    length = (green[-1] - green[0]) / (sample.force_scale * 114)
    assert length == pytest.approx(effort, rel=0.08)
    assert "50 N" in texts and "5 kN" not in texts


@pytest.mark.parametrize("drive", ["speed", "torque"])
@pytest.mark.parametrize(("steps", "action"), [(1, 0.01), (1, 0.4), (25, 0.4)])
def test_drawn_forces_are_those_of_the_patches(drive, steps, action):
    still = {"start": {**CENTRED, "speed": 0.0}}
    env = episode(still, vehicle="focchi", plant="distributed", drive=drive, reference=SLOW)
    for _ in range(steps):
        env.step(np.array([0.5 * action, action], dtype=np.float32))
    simulation = env.simulation
    shot = snapshot.take(simulation, 0)
    state = shot.state
    loads = np.zeros((1, 6))
    speeds = np.array([[state.sprocket_speed_left, state.sprocket_speed_right]])
    hold_speeds(
        np.array([state[:6]]), speeds, np.array([shot.parameters]), make_patches(10, 4),
        0, simulation.solver.substep, False, loads,
    )  # fmt: skip
    assert (state.effort_left, state.effort_right) == pytest.approx(loads[0, :2], rel=1e-6)
    assert shot.resistance == pytest.approx(loads[0, 2:4], rel=1e-6)
    assert shot.lateral_force == pytest.approx(loads[0, 4], rel=1e-6)
    drawbar = state.effort_left + state.effort_right - sum(shot.resistance)
    assert drawbar == pytest.approx(shot.parameters.mass * state.acceleration_x, rel=1e-9)


def test_bars_and_markers_show_what_the_action_commands(texts):
    env = light()
    by_speed = last_picture(env, 20, 0.5, -0.5)
    assert {"Sprocket speed, of ±10 rad/s", "torque [N m]", "+5.00", "-5.00"} <= set(texts)
    assert "sprocket [rad/s]" not in texts
    torque = snapshot.take(env.simulation, 0).state.torque_left
    assert torque > 1.0 and f"{torque:+.1f}" in texts
    assert by_speed[188, 640 + 144 + 35].tolist() == list(canvas.GREEN)
    assert by_speed[188, 640 + 144 + 50].tolist() != list(canvas.GREEN)
    assert by_speed[210, 640 + 144 - 35].tolist() == list(canvas.VERMILLION)
    assert by_speed[179, 640 + 144 + 44].tolist() == list(canvas.INK)
    texts.clear()
    last_picture(light(drive="torque"), 20, 0.25, -0.25)
    assert {"Torque, of ±40 N m", "sprocket [rad/s]", "+10.0", "-10.0"} <= set(texts)
    texts.clear()
    last_picture(episode(plant="distributed"), 20, 0.25, 0.25)
    assert {"Torque, of ±8 kN m", "+2.00"} <= set(texts)


def after(strings, label):
    """What is written right after the last such label."""
    return strings[len(strings) - strings[::-1].index(label)]


def test_the_panel_lists_what_the_plant_knows_with_enough_digits(texts):
    last_picture(light(), 1)
    assert after(texts, "inertia I [kg m²]") == "4.5"
    assert after(texts, "motion resistance") == "0.025"
    assert after(texts, "friction μ = tan φ") == "0.40"
    assert after(texts, "friction angle φ [°]") == "21.8"
    assert "lateral resistance" not in texts
    texts.clear()
    last_picture(light(plant="lumped", drive="torque"), 1)
    assert after(texts, "lateral resistance") == "0.40"
    assert "friction μ = tan φ" not in texts


def test_ground_and_notices_of_the_distributed_plant_leave_the_lateral_resistance_out(
    texts, monkeypatch
):
    step = {"kind": "ramp", "start": 0.1}
    changes = [
        {"parameter": "lateral_resistance", "target": 0.2, **step},
        {"parameter": "longitudinal_resistance", "target": 0.018, **step},
        {"parameter": "lateral_resistance", "kind": "region", "target": 0.1, "x": 5.0, "y": 0.0,
         "radius": 1.0, "edge": 0.1},
    ]  # fmt: skip

    def changing(rng, nominal, *_):
        return Draw(nominal, changes)

    monkeypatch.setitem(UNCERTAINTY_SETS, "nominal", changing)
    for plant, drive in (("distributed", "speed"), ("lumped", "torque")):
        texts.clear()
        env = light(plant=plant, drive=drive, uncertainty="nominal")
        last_picture(env, 8, 0.1, 0.1)
        assert "motion resistance: 0.025 → 0.018" in texts
        lumped = plant == "lumped"
        assert ("lateral resistance: 0.40 → 0.20" in texts) == lumped
        assert ("soil: lateral resistance [-]" in texts) == lumped
        assert ("soil: friction angle φ [°]" in texts) != lumped
