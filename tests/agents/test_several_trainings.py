"""Several trainings: the agents of single ones, whatever is killed, and one table at the end."""

import json
import multiprocessing
import os
import shutil
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import train
from agents import sweep as families
from agents.folder import CONFIG
from agents.options import Several, parse
from agents.run import SENSOR_MIXTURE, resolve
from agents.sweep import Job, Place, parse_seeds, planned, read_sweep, train_all
from tests.agents.agent_cases import Config, same_arrays, small
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.executors import WorkerPool
from tracked_env.benchmark.policies import default_names, registered_policies

SMALL = (
    "--quiet", "--vehicles", "4", "--held-out", "2", "--duration", "1", "--uncertainty", "payload",
    "--ppo.n-steps", "32", "--ppo.batch-size", "128", "--ppo.n-epochs", "2", "--ppo.hidden", "16",
)  # fmt: skip

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")
SWEEP = {
    "output": "swept", "agents": ["ppo"], "augmentations": ["blind", "history"], "seeds": [1],
    "uncertainty": ["payload"], "sets": ["payload"], "episodes": 4,
    "options": {
        "steps": 256, "vehicles": 4, "duration": 1.0, "held_out": 2,
        "ppo": {"n_steps": 32, "batch_size": 128, "n_epochs": 2, "hidden": [16]},
    },
}  # fmt: skip


@pytest.mark.slow
def test_seeds_in_workers_make_the_agents_of_single_trainings_and_keep_the_users_command(
    repository, monkeypatch, capsys
):
    asked = [str(repository / "train.py"), *SMALL, "--steps", "512", "--seeds", "1,2",
             "--workers", "2", "--output", "several"]  # fmt: skip
    monkeypatch.setattr("sys.argv", asked)
    assert train.command(asked[1:]) == 0
    assert sorted(path.name for path in Path("several").iterdir()) == [
        "ppo-blind-seed1",
        "ppo-blind-seed2",
    ]
    words = [*SMALL, "--steps", "512", "--seed", "2", "--output", "alone"]
    options, _ = parse(words, Config)
    assert train.main(options) == 0
    several = Path("several/ppo-blind-seed2")
    assert same_arrays(several / "agent.zip", Path("alone/agent.zip"))
    recipe = json.loads((several / CONFIG).read_text())
    assert recipe["command"].split()[1:] == asked
    assert recipe["config"]["seed"] == 2 and "workers" not in recipe["config"]
    assert train.command(asked[1:]) == 2
    assert "holds a finished training" in capsys.readouterr().err


@pytest.mark.slow
def test_a_killed_worker_costs_a_training_what_it_did_since_its_checkpoint(capfd):
    options = replace(small(Path("killed")), steps=4096, evaluate_every=4096)
    train.prepare(options)
    jobs, killed = {"killed": options}, False

    def kill():
        nonlocal killed
        until = time.monotonic() + 100
        while not Path("killed/checkpoint-before.zip").exists() and time.monotonic() < until:
            time.sleep(0.005)
        (worker,) = multiprocessing.active_children()
        os.kill(worker.pid, signal.SIGKILL)
        killed = True

    thread = threading.Thread(target=kill)
    thread.start()
    assert train_all(jobs, WorkerPool(1), train.train_one, quiet=True) == 0
    thread.join()
    assert killed
    said = capfd.readouterr().err
    assert "training killed was lost because its process ended (signal 9)" in said
    assert train.main(replace(options, output=Path("alone"))) == 0
    assert same_arrays(Path("killed/last.zip"), Path("alone/last.zip"))


@pytest.mark.slow
def test_a_sweep_trains_what_its_file_says_goes_on_and_ends_in_an_evaluation(capsys):
    Path("sweep.json").write_text(json.dumps(SWEEP))
    command = ["--sweep", "sweep.json"]
    assert train.command(command) == 0
    (page,) = Path("swept/evaluation").rglob("summary.md")
    table, printed = page.read_text(), capsys.readouterr().out
    for name in ("nominal", "adaptive", "oracle", "ppo-blind", "ppo-history"):
        assert name in table and name in printed
    written = {path: path.stat().st_mtime_ns for path in Path("swept").rglob("agent.zip")}
    assert len(written) == 2
    shutil.rmtree("swept/ppo-blind-seed1")
    assert train.command(command) == 0
    assert page.read_text() == table
    after = {path: path.stat().st_mtime_ns for path in Path("swept").rglob("agent.zip")}
    assert {path for path in written if after[path] != written[path]} == {
        Path("swept/ppo-blind-seed1/agent.zip")
    }


def test_a_folder_that_a_node_does_not_see_is_said(tmp_path):
    trainings, _ = planned(Config(output=Path("x")), Several(seeds="1"))
    (name,) = trainings
    job = Job(name, vars(trainings[name]))
    trained = train.train_one(Place(["train.py"], str(tmp_path)), job)
    assert trained.failed and "a disk that all nodes share" in trained.line


@pytest.mark.slow
def test_one_training_that_fails_is_said_and_the_others_go_on(capfd):
    good = small(Path("good"))
    bad = replace(small(Path("bad")), resume=True, sensors=("rtk", "nope"))
    swept = {"bad": bad, "good": good}
    for each in swept.values():
        train.prepare(each)
    assert train_all(swept, WorkerPool(1), train.train_one, quiet=True) == 1
    assert "bad: unknown sensor preset 'nope'" in capfd.readouterr().err
    assert Path("good/agent.zip").exists()


@pytest.mark.parametrize(
    ("given", "seeds"),
    [("0:3", (0, 1, 2)), (":2", (0, 1)), ("4", (4,)), ("5,1", (5, 1)), ([2, 0], (2, 0))],
)
def test_seeds_are_ranges_or_lists(given, seeds):
    assert parse_seeds(given) == seeds


@pytest.mark.parametrize("given", ["", "a", "3:3", "1:", "1,1", "-1", "1:2:3", [1.5], [True], 3])
def test_seeds_that_are_none_are_a_clear_error(given):
    with pytest.raises(ValueError, match=r"^seeds = .*must be FIRST:END"):
        parse_seeds(given)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"agentz": ["ppo"]}, "unknown sweep key 'agentz'"),
        ({"agents": None}, "agents = None; must be a list"),
        ({"agents": ["dqn"]}, "--agent: invalid choice: 'dqn'"),
        ({"augmentations": ["blnd"]}, "--augmentation: invalid choice: 'blnd'"),
        ({"augmentations": ["blind", "blind"]}, "must name each entry once"),
        ({"options": {"step": 3}}, "unknown options key 'step'"),
        ({"options": {"seed": 3}}, "unknown options key 'seed'"),
        (
            {"options": {"ppo": {"nsteps": 3}}},
            "unrecognized arguments: --ppo.nsteps=3; did you mean --ppo.n-steps?",
        ),
        ({"options": {"vehicles": "many"}}, "--vehicles: many; must be a whole number"),
        ({"options": {"vehicles": 0}}, "vehicles = 0; must be in [1, 65536]"),
        ({"seeds": "2:1"}, "seeds = '2:1'; must be FIRST:END"),
        ({"episodes": 0}, "episodes = 0; must be a whole number of at least 1"),
        ({"output": ""}, "output = ''; must name a folder"),
    ],
)
def test_a_wrong_sweep_file_is_one_line_that_names_it(changes, message):
    Path("sweep.json").write_text(json.dumps({**SWEEP, **changes}))
    with pytest.raises(ValueError) as error:
        read_sweep(Path("sweep.json"), Config)
    assert str(error.value).startswith("sweep file sweep.json: ") and message in str(error.value)
    assert "\n" not in str(error.value)


def test_the_example_of_the_page_is_a_sweep(repository):
    page = (repository / "docs" / "scale.md").read_text(encoding="utf-8")
    Path("sweep.toml").write_text(page.partition("```toml\n")[2].partition("```")[0])
    plan = read_sweep(Path("sweep.toml"), Config)
    assert len(plan.trainings) == 8
    assert all(len(trainings) == 5 for trainings in plan.trainings.values())
    training = plan.trainings["sac-history-drift-mixed"][3]
    assert (training.agent, training.augmentation, training.seed) == ("sac", "history", 3)
    assert training.uncertainty == ("drift", "mixed") and training.steps == 200000
    assert training.folder == Path("runs/history/sac-history-drift-mixed-seed3")


@pytest.mark.parametrize(
    ("env", "low", "high"),
    [
        (TORQUE_ID, "nominal", "oracle"),
        (SPEED_ID, "uc", "slc-oracle"),
        (TERRAIN_ID, "uc", "slc-oracle"),
    ],
)
def test_a_sweep_is_compared_with_the_controllers_of_its_environment(env, low, high):
    given = {"output": "swept", "agents": ["ppo"], "options": {"env": env}}
    Path("sweep.json").write_text(json.dumps(given))
    compare = read_sweep(Path("sweep.json"), Config).compare
    assert (compare[0], compare[-1]) == (low, high)
    assert set(compare) <= set(default_names(registered_policies(), env))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--workers", "2"), "--workers is of several trainings; give --seeds or --sweep too"),
        (("--seeds", "0:2", "--workers", "0"), "workers = 0; must be at least 1"),
        (("--seeds", "0:2", "--workers", "1", "--shard", "1/2"), "choose one of them"),
        (("--seeds", "0:2", "--shard", "3/2"), "shard '3/2'"),
        (("--seeds", "0:2", "--sweep", "a.toml"), "the seeds of a sweep are in its file"),
        (("--sweep", "a.toml"), "sweep file a.toml: "),
        (("--sweep", "a.toml", "--steps", "5"), "--steps beside --sweep; write it into a.toml"),
        (("--seeds", "0:2", "--uncertainty", "nope"), "soil-and-mass"),
    ],
)
def test_a_wrong_command_is_one_line_and_leaves_nothing(arguments, message, capsys):
    assert train.command(list(arguments)) == 2
    shown = capsys.readouterr().err
    assert message in shown and shown.count("\n") == 1
    assert not list(Path().iterdir())


# The families of agents: on equal terms, and all of them commands that train.py takes

FAMILIES = [(env, name) for env, of_env in families.FAMILIES.items() for name in of_env]


def options(env, family, tmp_path):
    words = families.command(env, family, 3, tmp_path)
    return parse(words, Config)[0]


@pytest.mark.parametrize(("env", "family"), FAMILIES)
def test_every_family_meets_the_same_laws_sensors_and_action_rate_penalty(env, family, tmp_path):
    run = resolve(options(env, family, tmp_path))
    assert run.recipe["config"]["uncertainty"] == ["mixture"] and run.seed > 2**24
    assert run.options.folder == tmp_path / env / f"{family}-seed3"
    assert run.arguments["sensors"] == [*SENSOR_MIXTURE[f"tracked_env/{env}"]]
    assert run.augmentation.options["data_sheet"] is True
    assert run.options.smoothness == 1.0


def test_families_of_ppo_say_how_many_environment_steps(tmp_path):
    """They say it themselves: the default of train.py may change."""
    on_policy = [name for name in families.FAMILIES["Torque-v0"] if "ppo" in name]
    assert len(on_policy) == 2
    for name in on_policy:
        words = families.command("Torque-v0", name, 3, tmp_path)
        said = int(words[words.index("--steps") + 1])
        assert said == resolve(options("Torque-v0", name, tmp_path)).options.steps
        assert said == {"ppo-blind": 2_000_000, "ppo-estimates": 3_000_000}[name]


def test_trainings_run_one_after_the_other_and_a_failed_one_is_said(tmp_path, monkeypatch, capsys):
    begun = []

    def run(words, **_):
        begun.append(words[words.index("--output") + 1])
        return SimpleNamespace(returncode=int("ppo-estimates" in begun[-1]))

    monkeypatch.setattr(families.subprocess, "run", run)
    monkeypatch.setattr(families, "ROOT", tmp_path)
    chosen = ["--families", "ppo-estimates", "ppo-blind", "--envs", "Torque-v0", "--seeds", "0:2"]
    assert families.main([*chosen, "--output", "out"]) == 1
    assert [name.rpartition("/")[2] for name in begun] == [
        "ppo-blind-seed0",
        "ppo-estimates-seed0",
        "ppo-blind-seed1",
        "ppo-estimates-seed1",
    ]
    said = capsys.readouterr().out
    assert "ppo-blind seed 1: done" in said
    assert said.count("failed") == 2
    with pytest.raises(SystemExit):
        families.main(["--families", "nobody"])
    assert "invalid choice: 'nobody'" in capsys.readouterr().err
