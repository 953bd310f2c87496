"""`tracked-env drive`, without a screen: keys are posted as a person presses them."""

import sys

import gymnasium
import pygame
import pytest

from tracked_env.cli.episode_commands import REACH, Controls
from tracked_env.cli.main import main
from tracked_env.physics.parameters import VEHICLES
from tracked_env.rendering import Renderer

PERIOD = 0.02  # [s]
FULL, TURN = REACH["speed"]
MEADOW = """
import gymnasium
from tracked_env.env import TrackedVehicleEnv

class Own(TrackedVehicleEnv):
    def reset(self, **options):
        Own.made = self
        return super().reset(**options)

gymnasium.register(
    "meadow/Slow-v0", Own, kwargs={"vehicle": "focchi"},
    vector_entry_point="tracked_env.vector_env:TrackedVehicleVectorEnv",
)
"""


def key(kind, name):
    return pygame.event.Event(kind, key=name)


def after(seconds, controls):
    for _ in range(round(seconds / PERIOD)):
        action = controls.action(PERIOD)
    found = action.tolist()
    return found


def test_keys_move_both_tracks_ahead_and_apart():
    controls = Controls("speed")
    controls.take([key(pygame.KEYDOWN, pygame.K_UP)])
    assert 0.0 < controls.action(PERIOD)[0] < 0.1  # no jump
    assert after(1.0, controls) == pytest.approx([FULL, FULL])
    controls.take([key(pygame.KEYDOWN, pygame.K_LEFT)])
    assert after(1.0, controls) == pytest.approx([FULL - TURN, FULL + TURN])
    controls.take([key(pygame.KEYUP, pygame.K_UP), key(pygame.KEYUP, pygame.K_LEFT)])
    assert after(1.0, controls) == [0.0, 0.0]
    controls.take([key(pygame.KEYDOWN, pygame.K_s), key(pygame.KEYDOWN, pygame.K_d)])
    assert after(1.0, controls) == pytest.approx([TURN - FULL, -FULL - TURN])
    controls.take([key(pygame.KEYDOWN, pygame.K_SPACE)])
    assert controls.action(PERIOD).tolist() == [0.0, 0.0]


@pytest.fixture
def seen(monkeypatch):
    """Posts events at pictures; returns what each picture was drawn from."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr("tracked_env.cli.main.end_at_interrupt", lambda program: None)

    def post_at(events):
        pictures = []
        draw = Renderer.draw

        def drawn(self, simulation, row, beliefs=None):
            answer = draw(self, simulation, row, beliefs)
            state = {name: float(simulation.column(name)[row]) for name in ("v_x", "yaw_rate")}
            pictures.append((simulation.episodes[row], state, beliefs))
            for event in events.get(len(pictures), ()):
                pygame.event.post(event)
            return answer

        monkeypatch.setattr(Renderer, "draw", drawn)
        return pictures

    return post_at


def test_a_person_drives_and_sees_what_the_observer_believes(seen, capsys):
    presses = {2: pygame.K_UP, 40: pygame.K_LEFT, 60: pygame.K_r, 70: pygame.K_ESCAPE}
    pictures = seen({at: [key(pygame.KEYDOWN, name)] for at, name in presses.items()})
    pygame.display.init()
    pygame.event.post(pygame.event.Event(pygame.QUIT))  # of a window before this one
    assert main(["drive", "--set", "payload", "--seed", "5"]) == 0
    assert len(pictures) == 70
    (first, slow, before), (_, fast, believed), (_, turning, _) = (pictures[k] for k in (1, 39, 59))
    assert fast["v_x"] > slow["v_x"] + 0.3 and turning["yaw_rate"] > 0.1
    value, deviation = believed["mass"]
    assert 200.0 < value < 5000.0 and deviation < before["mass"][1]
    again = pictures[-1][0]
    assert again.noise_seed != first.noise_seed
    shown = capsys.readouterr().out
    assert "arrows" in shown and "s driven, RMSE" in shown and "set payload, seed 5" in shown


def test_closing_the_window_ends_a_drive_without_an_observer(seen):
    pictures = seen({3: [pygame.event.Event(pygame.QUIT)]})
    assert main(["drive", "--env", "Speed-v0", "--observer", "none"]) == 0
    assert len(pictures) == 3 and pictures[-1][2] is None


def test_a_person_drives_an_environment_of_another_project(seen, tmp_path, monkeypatch):
    (tmp_path / "meadow.py").write_text(MEADOW, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    pictures = seen({3: [pygame.event.Event(pygame.QUIT)]})
    assert (
        main(["drive", "--env", "meadow:meadow/Slow-v0", "--set", "payload", "--observer", "none"])
        == 0
    )
    assert len(pictures) == 3
    made = sys.modules.pop("meadow").Own.made
    assert made.simulation.solver.nominal.mass == VEHICLES["focchi"].mass
    del gymnasium.registry["meadow/Slow-v0"]


def test_without_pygame_driving_says_what_to_install(seen, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("tracked_env.rendering")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr("tracked_env.rendering", raising=False)
    monkeypatch.setitem(sys.modules, "pygame", None)
    assert main(["drive"]) == 1
    error = capsys.readouterr().err
    assert 'pip install "tracked-env[render]"' in error and error.count("\n") == 1
