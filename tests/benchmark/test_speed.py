"""The rows of the speed table measure what they say, and two checkouts are compared row by row."""

import numpy as np
import pytest

from baselines.registry import BY_DRIVE
from tests.benchmark.test_leaderboard import script
from tracked_env.plants import find

MODES = ("calm", "random", "episodes")


@pytest.fixture
def speed(repository):
    """benchmarks/speed.py."""
    return script(repository, "speed")


def load_of(speed, name):
    """What the row of this name repeats."""
    (row,) = [row for row in speed.rows([]) if row.name == name]
    return row.make()


def simulation(load):
    """Of the environment that a row steps."""
    return load.prepare.__self__.unwrapped.simulation


def test_every_plant_drive_and_registered_controller_has_rows(speed):
    names = [row.name for row in speed.rows(speed.controllers())]
    assert len(names) == len(set(names))
    for mode in MODES:
        for label in ("Torque-v0", "Torque-v0 distributed", "Speed-v0", "Terrain-v0"):
            assert f"{label} step, {mode}" in names and f"{label} vector, 64, {mode}" in names
        assert f"Torque-v0 vector, 4096, {mode}" in names
    for drive, policies in BY_DRIVE.items():
        for policy in policies:
            of_policy = [name for name in names if f"predict {policy}, {drive}," in name]
            assert len(of_policy) == (0 if "oracle" in policy else 2)
    assert all(
        any(f"({network})" in name for name in names) for network in ("MLP", "MLP on estimates")
    )
    peers = {row.peer for row in speed.rows([])}
    assert peers <= {*names} and speed.TRAINING_PEER in names


def test_every_plant_has_rows_with_every_drive_that_it_accepts(speed):
    timed = set()
    for _, env_id, arguments, _ in speed.ENVIRONMENTS:
        arguments = {name: value for name, value in arguments.items() if name != "threads"}
        config = speed.gymnasium.make(env_id, **arguments).unwrapped.simulation.config
        timed.add((config.plant, config.drive))
    ours = [find(name) for name in ("lumped", "distributed", "terrain")]
    assert timed == {(plant.name, drive) for plant in ours for drive in plant.reads}


@pytest.mark.parametrize("name", ["Torque-v0 step, calm", "Torque-v0 vector, 64, calm"])
def test_no_vehicle_ends_in_a_calm_pass(speed, name):
    load = load_of(speed, name)
    assert speed.calls_of_a_pass(load, 1e3) == load.calls
    for _ in range(2):
        speed.time_of_a_pass(load, load.calls)
        assert set(simulation(load).steps) == {load.calls}


@pytest.mark.parametrize("name", ["Torque-v0 step, episodes", "Torque-v0 vector, 64, episodes"])
def test_a_pass_of_episodes_is_one_whole_episode_and_its_reset(speed, name):
    load = load_of(speed, name)
    assert speed.calls_of_a_pass(load, 1e-9) == load.calls
    load.prepare()
    for _ in range(1499):
        load.call()
    assert set(simulation(load).steps) == {1499}
    for _ in range(load.calls - 1499):
        load.call()
    assert set(simulation(load).steps) == {0}


def test_every_pass_has_its_share_of_new_noise(speed):
    for name in ("Torque-v0 step, calm", "Torque-v0 vector, 64, random"):
        load = load_of(speed, name)
        for seconds in (1e-9, 1e-2):
            assert speed.calls_of_a_pass(load, seconds) % speed.NOISE == 0


def test_the_best_of_the_same_number_of_passes_counts(speed, monkeypatch):
    times = iter([3.0, 1.0, 2.0, 5.0, 4.0, 6.0, 7.0])
    monkeypatch.setattr(speed, "time_of_a_pass", lambda load, calls: next(times))
    row = speed.Row("a", 4, "a", lambda: speed.Load(lambda: None))
    assert speed.measure(row, 1e-6) == (1e6 / 4, 1) and next(times, None) is None


@pytest.mark.parametrize(
    "name, threads",
    [
        ("Terrain-v0 vector, 64, calm", 2),
        ("Terrain-v0 on one thread vector, 64, calm", 1),
        ("Torque-v0 vector, 64, calm", 1),
        ("Torque-v0 step, calm", 1),
        ("CartPole-v1 vector, 64", 1),
    ],
)
def test_a_row_says_on_how_many_threads_it_runs(speed, name, threads):
    load = load_of(speed, name)
    assert load.threads == threads
    table = speed.markdown({name: (2.0, threads)}, {name: name}, "")
    assert f"| {name} | {threads} | 2.000 | 500,000 | 1.00 | {name} |" in table


@pytest.mark.slow
def test_two_checkouts_are_timed_in_turns_and_a_row_that_one_lacks_is_nan(
    speed, tmp_path, monkeypatch, capsys
):
    other = tmp_path / "other" / "benchmarks" / "speed.py"
    other.parent.mkdir(parents=True)
    other.write_text("print('| CartPole-v1 step | 1 | 0.001 | 1 | 1.00 | CartPole-v1 step |')")
    options = [
        "--rows",
        "CartPole-v1 step",
        "--seconds",
        "0.1",
        "--against",
        str(tmp_path / "other"),
    ]
    monkeypatch.setattr("sys.argv", ["speed.py", *options])
    monkeypatch.setattr(speed, "ROUNDS", 2)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    speed.main()
    rows = capsys.readouterr().out.splitlines()
    cells = {row.split("|")[1].strip(): row.split("|")[2:-1] for row in rows}
    ours, theirs, ratio = cells["CartPole-v1 step"]
    assert float(ours) > 0.0 and float(theirs) == 0.001 and "slower" in ratio
    assert float(cells["Pendulum-v1 step"][0]) > 0.0 and np.isnan(
        float(cells["Pendulum-v1 step"][1])
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments, says",
    [
        (("--against", "/nowhere"), "--against /nowhere: no benchmarks/speed.py there"),
        (("--rows", "nothing"), "--rows nothing: no such row; there are"),
        (("--rows", "CartPole", "--publish"), "--publish needs all rows"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_timed(
    arguments, says, speed, monkeypatch, capsys
):
    monkeypatch.setattr("sys.argv", ["speed.py", *arguments])
    with pytest.raises(SystemExit) as refused:
        speed.main()
    assert refused.value.code != 0 and says in f"{refused.value}{capsys.readouterr().err}"
