"""The families of agents: on equal terms, and all of them commands that train.py takes."""

from types import SimpleNamespace

import pytest

from agents import families
from agents.options import options_of_train, parse
from agents.run import SENSOR_MIXTURE, resolve

ALL = [(env, name) for env, of_env in families.FAMILIES.items() for name in of_env]


def options(env, family, tmp_path):
    words = families.command(env, family, 3, tmp_path)
    return parse(words, options_of_train())[0]


@pytest.mark.parametrize(("env", "family"), ALL)
def test_every_family_meets_the_same_laws_sensors_and_action_rate_penalty(env, family, tmp_path):
    run = resolve(options(env, family, tmp_path))
    assert run.recipe["config"]["uncertainty"] == ["mixture"] and run.seed > 2**24
    assert run.folder == tmp_path / env / f"{family}-seed3"
    if run.augmentation.kind == "teacher":  # knows what the others have to infer
        assert run.arguments["sensors"] == "ideal"
        return
    assert run.arguments["sensors"] == [*SENSOR_MIXTURE[f"tracked_env/{env}"]]
    assert run.augmentation.options["data_sheet"] is True
    if run.augmentation.kind != "student":  # regressed, without rewards
        assert run.reward.smoothness == 1.0


def test_families_of_ppo_say_how_many_environment_steps_and_have_the_same(tmp_path):
    """They say it themselves: the default of train.py may change."""
    on_policy = [name for name in families.FAMILIES["Torque-v0"] if "ppo" in name]
    assert len(on_policy) == 10
    for name in on_policy:
        words = families.command("Torque-v0", name, 3, tmp_path)
        said = int(words[words.index("--steps") + 1])
        assert said == resolve(options("Torque-v0", name, tmp_path)).schedule.total
        fewer = name.startswith(("ppo-student", "ppo-residual"))
        assert said <= 2_000_000 if fewer else said == 2_000_000


def test_a_student_learns_from_the_teacher_of_its_seed_which_was_trained_before(tmp_path):
    for student, teacher in families.TEACHERS.items():
        names = [*families.FAMILIES["Torque-v0"]]
        assert names.index(teacher) < names.index(student)
        given = options("Torque-v0", student, tmp_path)
        assert given.teacher == tmp_path / "Torque-v0" / f"{teacher}-seed3" / "agent.zip"


def test_trainings_run_one_after_the_other_and_a_failed_one_is_said(tmp_path, monkeypatch, capsys):
    begun = []

    def run(words, **_):
        begun.append(words[words.index("--output") + 1])
        folder = tmp_path / begun[-1]
        folder.mkdir(parents=True)
        rows = "steps,seconds,cpu_seconds,mean_return,held_out_rmse\n64,1,90,0,nan\n128,2,120,0,"
        (folder / "curve.csv").write_text(f"{rows}0.5\n")
        return SimpleNamespace(returncode=int("sac-blind" in begun[-1]))

    monkeypatch.setattr(families.subprocess, "run", run)
    monkeypatch.setattr(families, "ROOT", tmp_path)
    chosen = ["--families", "sac-blind", "ppo-blind", "--envs", "Torque-v0", "--seeds", "0:2"]
    assert families.main([*chosen, "--output", "out"]) == 1
    assert [name.rpartition("/")[2] for name in begun] == [
        "ppo-blind-seed0", "sac-blind-seed0", "ppo-blind-seed1", "sac-blind-seed1",
    ]  # fmt: skip
    said = capsys.readouterr().out
    assert "ppo-blind seed 1: 2.0 min of processor time, best 0.5000 m held out" in said
    assert said.count("failed") == 2
    with pytest.raises(SystemExit):
        families.main(["--families", "nobody"])
    assert "unknown family 'nobody'" in capsys.readouterr().err
