"""Pictures come in every way Gymnasium asks for them, repeat, and name what is wrong."""

import warnings

import gymnasium
import numpy as np
import pygame
import pytest
from gymnasium.utils.env_checker import check_env

import tracked_env  # noqa: F401
from tests.processes import python
from tests.rendering.picture_cases import CENTRED, SHAPE, episode, last_picture
from tracked_env import arrays as b
from tracked_env.env import TrackedVehicleEnv
from tracked_env.rendering import Renderer, canvas, snapshot
from tracked_env.vector_env import TrackedVehicleVectorEnv

ID = "tracked_env/Torque-v0"


def test_a_picture_is_an_rgb_array_and_opens_no_window():
    picture = last_picture(episode(), 3)
    assert (picture.shape, picture.dtype) == (SHAPE, np.uint8)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    code = (
        "import gymnasium, pygame, tracked_env\n"
        "from tracked_env.rendering import Renderer, TerrainSource\n"
        f"env = gymnasium.make('{ID}', render_mode='rgb_array')\n"
        "env.reset(seed=0); env.render()\n"
        "behind = Renderer('rgb_array', 50, view='3d', terrain=TerrainSource())\n"
        "picture = behind.draw(env.unwrapped.simulation, 0)\n"
        "assert picture.shape == (800, 960, 3) and picture.std() > 20.0\n"
        "assert not pygame.display.get_init() and pygame.display.get_surface() is None"
    )
    python("-c", code)


def test_the_same_calls_give_the_same_pixels():
    first, second = (episode(uncertainty="mixed", sensors="rtk") for _ in range(2))
    one, other = last_picture(first, 20, 0.2, 0.4), last_picture(second, 20, 0.2, 0.4)
    assert np.array_equal(one, other)
    again = first.render()
    assert np.array_equal(one, again)
    assert not np.array_equal(one, last_picture(first, 20))


def test_a_new_episode_forgets_the_old_one():
    second = episode()
    last_picture(second, 30)
    second.reset(seed=3, options={"start": CENTRED})
    assert np.array_equal(last_picture(second, 5), last_picture(episode(), 5))


def test_the_vector_environment_draws_each_row_as_the_single_one_does():
    vector = TrackedVehicleVectorEnv(2, render_mode="rgb_array")
    single = TrackedVehicleEnv(render_mode="rgb_array")
    vector.reset(seed=5)
    single.reset(seed=6)
    action = np.array([0.3, 0.2], dtype=np.float32)
    for _ in range(5):
        vector.step(np.stack([action, action]))
        single.step(action)
        pictures, picture = vector.render(), single.render()
    assert len(pictures) == 2
    assert np.array_equal(pictures[1], picture)
    assert not np.array_equal(pictures[0], picture)
    vector.close()


def test_closing_twice_and_drawing_again_work_even_after_pygame_quit():
    env = episode()
    drawing = Renderer("rgb_array", 50)
    drawing.close()
    for disturb in (drawing.close, drawing.close, pygame.quit, pygame.font.init):
        disturb()
        picture = last_picture(env, 1)
        again = drawing.draw(env.simulation, 0)
        assert np.abs(again.astype(int) - picture).mean() < 0.5


def test_a_window_shows_what_the_array_holds_and_closes():
    env = episode()
    human, other = Renderer("human", 1000), Renderer("human", 1000)
    picture = Renderer("rgb_array", 50).draw(env.simulation, 0)
    for window in (human, other):
        assert window.draw(env.simulation, 0) is None
    assert human._window is not other._window
    assert np.array_equal(canvas.to_array(human._window.get_surface()), picture)
    for window in (human, human, other):
        window.close()
    assert human._window is None
    assert human.draw(env.simulation, 0) is None
    human.close()


def test_gymnasium_checks_the_environment_and_its_rendering_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(ID, render_mode="rgb_array").unwrapped)


def test_the_goal_of_a_plan_is_drawn_where_the_vehicle_has_to_stand():
    pictures = []
    for x in (1.5, 1.9):
        plan = {"kind": "plan", "goal": [x, 0.0, 0.0]}
        env = gymnasium.make("tracked_env/Speed-v0", reference=plan, uncertainty="nominal")
        start = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0}
        env.reset(seed=0, options={"start": start})
        picture = Renderer("rgb_array", 50, 100).draw(env.unwrapped.simulation, 0)
        scene = picture[40:580, :640].astype(int)  # without legend and panel
        purple = np.abs(scene - np.array(canvas.PURPLE)).sum(axis=2) < 30
        pictures.append(np.flatnonzero(purple.any(axis=0)).mean())
        assert purple.sum() > 50
    assert pictures[1] - pictures[0] == pytest.approx(40.0, abs=3.0)


def test_a_state_that_is_not_finite_is_drawn_and_named():
    env = episode()
    last_picture(env, 2)
    env.simulation.batch.floats[0, b.STATE : b.STATE + 6] = np.nan
    assert env.render() is not None
    assert "not finite" in snapshot.take(env.simulation, 0).ending


@pytest.mark.parametrize(
    "wrong",
    [
        {"render_mode": "ansi"},
        {"soil_parameter": "mass"},
        {"view": "side"},
    ],
    ids=str,
)
def test_wrong_arguments_are_named(wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(ValueError, match=name) as raised:
        Renderer(**{"render_mode": "rgb_array", "fps": 50, **wrong})
    assert str(value) in str(raised.value)


def test_nothing_is_drawn_before_the_first_episode():
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset"):
        TrackedVehicleEnv(render_mode="rgb_array").render()


@pytest.mark.parametrize(("module", "word"), [("None", "not installed"), ("Old()", "older")])
def test_without_pygame_ce_the_error_names_what_to_install(module, word):
    code = (
        "import sys, types, tracked_env\n"
        "Old = lambda: types.ModuleType('pygame')\n"
        f"sys.modules['pygame'] = {module}\n"
        "try:\n    import tracked_env.rendering\n"
        "except ImportError as error:\n    print(error)"
    )
    shown = python("-c", code).stdout
    assert 'tracked-env[render]"' in shown and word in shown
