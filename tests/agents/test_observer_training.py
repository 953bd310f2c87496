"""The training of a learned observer: its targets, its archive, going on where it stopped."""

from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

torch = pytest.importorskip("torch")

from agents import driven_episodes, observer, regression  # noqa: E402  needs torch
from agents.observer import Observer  # noqa: E402
from agents.untold_training import AnyVehicle  # noqa: E402
from baselines import registry  # noqa: E402
from baselines.learned.gated_network import BatchNetwork  # noqa: E402
from baselines.learned.learned_observer import FEATURES, LearnedObserver, observer_layers  # noqa: E402
from baselines.learned.trained_agent import open_agent  # noqa: E402
from baselines.registry import POLICIES  # noqa: E402
from tests.baselines.learned.test_learned_observer import vehicles, weights_of  # noqa: E402

TINY = "--episodes 16 --further 16 --rounds 1 --epochs 2 --chunk 40 --seed 3"


@pytest.fixture(autouse=True)
def short_episodes(monkeypatch):
    monkeypatch.setattr(regression, "DURATION", 3.0)


def options(folder, more=""):
    return observer.parse([*TINY.split(), "--output", str(folder), *more.split()])


def network_of(mask):
    return regression.GatedNetwork(12, 6, mask)


def train(chosen):
    regression.train(chosen, Observer(chosen))


def recipe_of(chosen):
    return regression.recipe_of(chosen, Observer(chosen).recipe())


def test_a_correction_by_the_target_shows_the_truth():
    env, context = vehicles(3)
    policy = POLICIES["mpc-adaptive"](context)
    policy.correct_motion(partial(LearnedObserver, None))
    notes = driven_episodes.Notes(3, context.vehicle)
    observation, _ = env.reset(seed=1)
    state = None
    for k in range(100):
        action, state = policy.predict(observation, state)
        notes.take(policy, env.simulation.batch.floats)
        of = policy.corrector
        shown = of.before + notes.targets[:, k, :6].astype(float) * of.units
        for column, name in ((3, "v_x"), (4, "v_y"), (5, "yaw_rate")):
            assert shown[:, column] == pytest.approx(env.simulation.column(name), abs=3e-4)
        true = [env.simulation.column(name) for name in ("x", "y", "yaw")]
        wanted = [env.simulation.column(f"reference_{name}") for name in ("x", "y", "yaw")]
        distance = np.hypot(wanted[0] - true[0], wanted[1] - true[1])
        assert np.hypot(shown[:, 0], shown[:, 1]) == pytest.approx(distance, abs=3e-4)
        assert shown[:, 2] == pytest.approx(wanted[2] - true[2], abs=3e-4)
        observation, *_ = env.step(action)


def test_the_weights_of_an_archive_are_the_network_on_plain_features():
    torch.manual_seed(0)
    network = network_of(torch.ones(len(FEATURES)))
    torch.nn.init.normal_(network.last.weight, std=0.1)
    x = torch.randn(20, 4, len(FEATURES)) * 2.0 + 0.5
    network.standardise(x.flatten(0, 1))
    expected = network(x)[0].detach().numpy()
    layers = observer_layers(network.weights(), True)
    run, hidden = BatchNetwork(layers, 4), np.zeros((4, regression.HIDDEN), np.float32)
    for inputs, right in zip(x.numpy(), expected, strict=True):
        assert run(inputs, hidden) == pytest.approx(right, abs=4e-3)  # of half precision


def test_slow_parts_are_those_of_a_filter_in_whole_and_in_chunks():
    r = torch.randn(90, 3, 6)
    low_pass = regression.LowPass([tau for tau, _ in observer.SLOW], torch.device("cpu"))
    whole, last, chunks = low_pass(r), None, []
    for at in (0, 40, 80):
        chunks.append(low_pass(r[at : at + 40], last))
        last = [each[-1] for each in chunks[-1]]
    for k, (tau, _) in enumerate(observer.SLOW):
        share = 0.02 / (tau + 0.02)
        expected = lfilter([share], [1.0, share - 1.0], r.numpy(), axis=0)
        assert np.abs(whole[k].numpy() - expected).max() < 1e-5
        assert np.abs(torch.cat([of[k] for of in chunks]).numpy() - expected).max() < 1e-5


def test_what_is_masked_has_no_effect():
    mask = torch.ones(len(FEATURES))
    mask[3] = 0.0
    network = network_of(mask)
    network.standardise(torch.randn(100, len(FEATURES)))
    layers = observer_layers(network.weights(), True)
    assert not layers.from_inputs[3].any()
    assert not layers.middle[regression.HIDDEN + 3].any()
    assert layers.from_inputs[2].any()


@pytest.mark.slow
def test_a_training_that_was_stopped_goes_on_to_the_same_weights(tmp_path, monkeypatch):
    train(options(tmp_path / "whole"))
    epoch = regression.Regression.epoch

    def stopping(self, number, count):
        if (number, count) == (1, 1):
            raise KeyboardInterrupt
        return epoch(self, number, count)

    monkeypatch.setattr(regression.Regression, "epoch", stopping)
    with pytest.raises(KeyboardInterrupt):
        train(options(tmp_path / "stopped"))
    monkeypatch.setattr(regression.Regression, "epoch", epoch)
    train(options(tmp_path / "stopped"))
    whole, stopped = (np.load(tmp_path / name / "round1.npz") for name in ("whole", "stopped"))
    assert np.array_equal(whole["features"], stopped["features"])
    assert (tmp_path / "whole" / "curve.csv").read_bytes() == (
        tmp_path / "stopped" / "curve.csv"
    ).read_bytes()
    _, context = vehicles(1)
    policy = open_agent(tmp_path / "stopped" / "agent.zip").make(context)
    assert policy.corrector.network.recurrent
    make, mass = open_agent(tmp_path / "whole" / "agent.zip").make, context.vehicle.mass
    make(context._replace(vehicle=context.vehicle._replace(mass=1.09 * mass)))
    heavier = context.vehicle._replace(mass=1.11 * mass)
    with pytest.raises(ValueError, match=r"another size: mass = 1609\.5 is not within 10% of 1450"):
        make(context._replace(vehicle=heavier))


def test_an_archive_that_is_installed_registers_both_policies(tmp_path, monkeypatch):
    path = tmp_path / "Torque-v0" / "mpc-learned-observer-seed0" / "agent.zip"
    path.parent.mkdir(parents=True)
    content = regression.archive(weights_of(), recipe_of(options(tmp_path)))
    path.write_bytes(content)
    monkeypatch.setattr(registry, "PRETRAINED", tmp_path)
    known = registry.policies()
    assert known["torque"]["mpc-learned-observer"] == [path]
    _, context = vehicles(1)
    policy = known[None]["adaptive-learned-observer"](context)
    assert type(policy) is type(POLICIES["adaptive"](context))
    assert type(open_agent(path).make(context)) is type(POLICIES["mpc-adaptive"](context))
    with pytest.raises(ValueError, match="takes its speed"):
        open_agent(path).make(context._replace(drive="speed"))
    with pytest.raises(ValueError, match=r"0\.02 s; this environment has 0\.01 s"):
        open_agent(path).make(context._replace(control_period=0.01))


@pytest.mark.parametrize(("task", "rounds"), [(Observer, 3), (AnyVehicle, 13)])
def test_no_episode_of_a_training_is_one_of_the_benchmark_or_of_another(tmp_path, task, rounds):
    trainings = [options(tmp_path, f"--seed {seed} --episodes 1076") for seed in range(3)]
    seeds = [
        set(range(job.first, job.first + job.count))
        for training in trainings
        for number in range(rounds)
        for job in regression.jobs_of(training, task, number)
    ]
    assert sum(map(len, seeds)) == len(set().union(*seeds))
    assert min(map(min, seeds)) > 2**33  # beyond those of train.py and of the benchmark
