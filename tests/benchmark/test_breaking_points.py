"""Breaking points: the bisection against known thresholds, the levels, and the command."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.studies import breaking_points
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import SETS, BenchmarkConfig
from tracked_env.sensors import make_sensors

# By axis: the fields of the sensors that differ between two of its levels.
SENSOR_FIELDS = {
    "pose-delay": {"pose_delay"}, "position-noise": {"position_noise"},
    "outage": {"pose_outage_length"},
}  # fmt: skip


@pytest.fixture(autouse=True)
def sets_of_before() -> Iterator[None]:
    """Levels are registered as sets, which tests of the catalogue do not expect."""
    before = dict(SETS)
    yield
    SETS.clear()
    SETS.update(before)


@pytest.mark.parametrize("axis", [*breaking_points.AXES])
@pytest.mark.parametrize("share", [0.013, 0.4, 0.77])
def test_the_bracket_holds_the_level_at_which_half_fail(axis: str, share: float) -> None:
    of, asked = breaking_points.AXES[axis], list[float]()
    limit = of.level(share)

    def success(level: float) -> float:
        asked.append(level)
        return 0.5 if abs(level - of.easy) <= abs(limit - of.easy) else 0.49

    *_, point = breaking_points.bisect(axis, "x", 16, success)
    assert abs(point.stands - of.easy) <= abs(limit - of.easy) < abs(point.breaks - of.easy)
    assert len(asked) == 2 + breaking_points.BISECTIONS == len(set(asked))
    width = np.log(point.breaks / point.stands) / np.log(of.hard / of.easy)
    assert width == pytest.approx(2.0**-breaking_points.BISECTIONS)
    assert point.success == 0.5


def test_where_it_never_breaks_or_always_does_the_other_end_is_nan() -> None:
    *_, always = breaking_points.bisect("mass", "x", 16, lambda level: 1.0)
    assert (always.stands, math.isnan(always.breaks)) == (10.0, True)
    *_, never = breaking_points.bisect("mass", "x", 16, lambda level: 0.2)
    assert (math.isnan(never.stands), never.breaks, never.success) == (True, 1.0, 0.2)
    assert breaking_points.table([always, never._replace(agent="y")])[1:] == [
        ["x", "stands 10"], ["y", "fails at 1"],
    ]  # fmt: skip


@pytest.mark.parametrize("env", [TORQUE_ID, SPEED_ID])
def test_the_levels_of_an_axis_change_what_it_names_and_nothing_else(env: str) -> None:
    drawn = {}
    for axis in breaking_points.AXES:
        for level in (breaking_points.AXES[axis].easy, breaking_points.AXES[axis].level(0.5)):
            name = breaking_points.set_of(env, axis, level)
            assert breaking_points.set_of(env, axis, level) == name and SETS[name].env == env
            made = BenchmarkConfig((name,)).environment(name, 1, truth=False)
            made.reset(seed=[5])
            (episode,) = made.simulation.episodes
            made.close()
            assert episode is not None
            drawn[axis, level] = episode
    for axis in breaking_points.AXES:
        easy, hard = (drawn[axis, breaking_points.AXES[axis].level(share)] for share in (0.0, 0.5))
        assert np.array_equal(easy.profile.table, hard.profile.table)
        assert easy.noise_seed == hard.noise_seed and easy.state == hard.state
        assert (repr(easy.sensors) == repr(hard.sensors)) == (axis in ("mass", "soil-strength"))
        before, after = (
            make_sensors(
                SETS[
                    breaking_points.set_of(env, axis, breaking_points.AXES[axis].level(share))
                ].sensors
            )._asdict()
            for share in (0.0, 0.5)
        )
        differing = {field for field in before if before[field] != after[field]}
        assert differing == SENSOR_FIELDS.get(axis, set())
        assert (easy.parameters == hard.parameters) == (axis not in ("mass", "soil-strength"))
    heavy, light = (
        drawn["mass", breaking_points.AXES["mass"].level(s)].parameters for s in (0.5, 0.0)
    )
    assert heavy.mass / light.mass == pytest.approx(10.0**0.5) == heavy.inertia / light.inertia
    weak = drawn["soil-strength", breaking_points.AXES["soil-strength"].level(0.5)].parameters
    assert math.tan(weak.friction_angle) / math.tan(light.friction_angle) == pytest.approx(
        0.02**0.5
    )
    assert weak.cohesion == pytest.approx(light.cohesion * 0.02**0.5)


def test_an_environment_without_axes_is_refused() -> None:
    with pytest.raises(ValueError, match="has no breaking points"):
        breaking_points.set_of(TERRAIN_ID, "mass", 1.0)


def test_the_command_writes_points_and_figure_and_continues_with_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(breaking_points, "BISECTIONS", 2)
    arguments = ["--policies", "nominal", "--axes", "mass", "--episodes", "2"]
    arguments += ["--output", str(tmp_path)]
    assert breaking_points.main(arguments, "program") == 0
    (folder,) = tmp_path.iterdir()
    with (folder / "breaking_points.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert 1.0 <= float(row["stands"]) < float(row["breaks"]) <= 10.0
    assert (row["trained_low"], row["trained_high"]) == ("0.5", "2.0")
    before = (folder / "episodes.jsonl").read_bytes()
    assert breaking_points.main(arguments, "program") == 0
    assert (folder / "episodes.jsonl").read_bytes() == before
    monkeypatch.setattr(breaking_points, "BISECTIONS", 3)
    assert breaking_points.main(arguments, "program") == 0
    later = (folder / "episodes.jsonl").read_bytes()
    assert later.startswith(before) and later.count(b"\n") == before.count(b"\n") + 1
    capsys.readouterr()
    assert breaking_points.main([*arguments, "--axes", "colour"], "program") == 2
    assert "program: unknown axis 'colour'" in capsys.readouterr().err
