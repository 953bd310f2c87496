"""What a picture remembers: notices of changes, travel of the belts, and the trail."""

import numpy as np
import pytest

from tests.rendering.picture_cases import driven, region, started
from tracked_env.rendering import snapshot
from tracked_env.rendering.scene import Memory


def test_a_notice_tells_what_has_changed_and_goes() -> None:
    step = {"parameter": "mass", "kind": "ramp", "target": 2320.0, "start": 0.1}
    env = started({"schedule": [step, region(1.0, 0.0, radius=0.3)]})
    memory = Memory(snapshot.take(env.simulation, 0))
    seen: dict[float, list[str]] = {}
    for _ in range(200):
        env.step(np.array([0.3, 0.3], dtype=np.float32))
        shot = snapshot.take(env.simulation, 0)
        memory.update(shot)
        seen[round(shot.time, 2)] = memory.notices()
    assert seen[0.08] == []
    assert seen[0.12] == ["mass m: 1450 → 2320 kg"]
    assert any("lateral resistance: 0.80 → 0.00" in lines for lines in seen.values())
    assert any("lateral resistance: 0.00 → 0.80" in lines for lines in seen.values())
    assert "mass m: 1450 → 2320 kg" not in seen[3.2]


def test_a_notice_is_seen_in_the_picture() -> None:
    step = {"parameter": "mass", "kind": "ramp", "target": 2320.0, "start": 0.1}
    env = started({"schedule": [step]})
    without, notice = driven(env, 3), driven(env, 4)
    box = np.s_[50:70, 260:420]
    assert without[box].min() > 100
    assert notice[box].min() < 80


def test_belts_run_and_trail_grows_with_the_vehicle() -> None:
    env = started()
    memory = Memory(snapshot.take(env.simulation, 0))
    travel = np.zeros(2)
    for _ in range(50):
        env.step(np.array([0.2, 0.5], dtype=np.float32))
        shot = snapshot.take(env.simulation, 0)
        memory.update(shot)
        speeds = np.array([shot.state.sprocket_speed_left, shot.state.sprocket_speed_right])
        travel += 0.02 * 0.3 * speeds
    assert memory.travel == pytest.approx(travel, rel=1e-9)
    assert travel[1] > travel[0] > 0.0
    assert np.hypot(*(memory.trail[-1] - shot.pose[:2])) < 0.1
    assert 10 < len(memory.trail) <= 51
