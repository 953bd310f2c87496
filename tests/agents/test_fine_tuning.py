"""Reinforcement learning from the policy for any vehicle: estimates, update, archive."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from agents import fine_tuning, regression  # noqa: E402  needs torch
from agents.fine_tuning import GAMMA, LAMBDA, Rollout, Tuning, advantages, reward_of  # noqa: E402
from agents.regression import Job  # noqa: E402
from baselines.learned.trained_agent import open_agent  # noqa: E402
from baselines.learned.untold_policy import AnyVehiclePolicy  # noqa: E402
from baselines.learned.vehicle_features import FEATURES  # noqa: E402
from baselines.registry import ANY, shipped_agents  # noqa: E402
from tracked_env import TORQUE_ID  # noqa: E402
from tracked_env.benchmark.policy_interface import PolicyContext  # noqa: E402

SHIPPED = shipped_agents(TORQUE_ID)[ANY][0]


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(regression, "DURATION", 3.0)
    monkeypatch.setattr(fine_tuning, "VEHICLES", 8)
    monkeypatch.setattr(fine_tuning, "HELD_OUT", 1)
    monkeypatch.setattr(fine_tuning, "LATER", 50)


def options(folder, more=""):
    words = f"--agent {SHIPPED} --output {folder} --iterations 2 --judging 1 --every 1 --chunk 40"
    return fine_tuning.parse([*words.split(), *more.split()])


def rollout(steps=30, count=3, lengths=(30, 30, 20), away=0.02, noise=0.0):
    shape = steps, count
    return Rollout(
        np.zeros((*shape, len(FEATURES)), np.float32), np.zeros((*shape, 17), np.float32),
        np.full((*shape, 2), noise, np.float32), np.zeros((1, count, 128), np.float32),
        np.full(shape, away), np.zeros(shape), np.array(lengths), np.array(lengths) < steps,
    )  # fmt: skip


def test_an_error_of_s_costs_half_a_logarithm_of_2_and_decades_of_errors_cost_alike(tmp_path):
    chosen = options(tmp_path)
    assert reward_of(chosen.scale, 0.0, chosen) == pytest.approx(-0.5 * np.log(2.0))
    one, ten, hundred = (reward_of(f * chosen.scale, 0.0, chosen) for f in (10.0, 100.0, 1000.0))
    assert ten - hundred == pytest.approx(np.log(10.0), rel=1e-3)
    assert one - ten == pytest.approx(np.log(10.0), rel=1e-2)
    assert reward_of(0.0, 0.5, chosen) == -0.5 * chosen.calm


def test_a_right_value_leaves_no_advantage_but_before_a_vehicle_is_lost(tmp_path):
    chosen, of = options(tmp_path), rollout()
    reward, worst = reward_of(0.02, 0.0, chosen), reward_of(fine_tuning.LOST, 0.0, chosen)
    advantage, driven = advantages(of, np.full((30, 3), reward), chosen)
    assert driven.sum(axis=0).tolist() == [30, 30, 20]
    np.testing.assert_allclose(advantage[:, :2], 0.0, atol=1e-12)  # they end by time
    left = np.arange(20)[::-1]
    expected = GAMMA * (worst - reward) * (GAMMA * LAMBDA) ** left
    np.testing.assert_allclose(advantage[:20, 2], expected, rtol=1e-9)
    assert not advantage[20:, 2].any()


def test_states_and_weights_of_a_rollout_are_those_of_the_network_that_drives(tmp_path):
    chosen = options(tmp_path)
    network, _ = fine_tuning.load(SHIPPED)
    of = fine_tuning.roll(network, Job(0, 2**41, 8, True, 1), np.zeros(2), chosen)
    assert of.features.shape == (150, 8, len(FEATURES))
    assert len(of.hidden) == 4
    assert not of.hidden[0].any()
    with torch.no_grad():
        x = torch.from_numpy(of.features)
        for k in range(3):
            state = torch.from_numpy(of.hidden[k : k + 1])
            after = network(x[40 * k : 40 * (k + 1)], state)[2]
            np.testing.assert_allclose(after[0].numpy(), of.hidden[k + 1], atol=2e-5)
    again = fine_tuning.roll(network, Job(0, 2**41, 8, True, 1), np.zeros(2), chosen)
    np.testing.assert_array_equal(of.away, again.away)
    noisy = fine_tuning.roll(network, Job(0, 2**41, 8, True, 1), np.full(2, 0.05), chosen)
    lasting = noisy.noise.reshape(15, 10, 8, 2)
    assert (lasting == lasting[:, :1]).all()
    assert noisy.noise.std() == pytest.approx(0.05, rel=0.2)  # 240 draws
    # Beyond the start: of differences of independent draws of both sides, and the answer to them.
    extra = (noisy.change - of.change)[50::10].mean()
    assert extra == pytest.approx(4.0 * 0.05**2, rel=0.35)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_update_goes_towards_actions_that_have_earned_more(sign, tmp_path):
    """Vehicles whose noise was `sign` came closer than the others."""
    chosen = options(tmp_path, "--rate 1e-3 --judging 0")
    network, _ = fine_tuning.load(SHIPPED)
    torch.manual_seed(0)
    tuning, of = Tuning(network, chosen), rollout(40, 8, (40,) * 8)
    noise = np.where(np.arange(8) < 4, 0.05, -0.05).astype(np.float32)
    of.noise[:] = noise[:, None]
    of.away[:] = np.where(noise * sign > 0.0, 0.001, 0.1)
    of = of._replace(lost=np.zeros(8, bool))
    x = torch.zeros(1, 1, len(FEATURES))
    before = network(x)[0].detach().numpy().copy()
    for _ in range(3):
        tuning.update(of, np.random.default_rng(0))
    moved = network(x)[0].detach().numpy() - before
    assert (sign * moved > 1e-4).all()


@pytest.mark.slow
def test_a_training_that_is_cut_ends_as_one_that_is_not_and_its_archive_drives(tmp_path):
    whole = options(tmp_path / "whole")
    fine_tuning.train(whole)
    cut = options(tmp_path / "cut")
    first = fine_tuning.held_out

    def stop(network, chosen):
        if (tmp_path / "cut" / "checkpoint.pt").exists():
            raise KeyboardInterrupt
        return first(network, chosen)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(fine_tuning, "held_out", stop)
        fine_tuning.train(cut)
    fine_tuning.train(cut)
    one, other = (open_agent(tmp_path / n / "agent.zip") for n in ("whole", "cut"))
    context = PolicyContext(0.02, "sliding")
    policies = [of.make(context) for of in (one, other)]
    assert isinstance(policies[0], AnyVehiclePolicy)
    for name, value in policies[0]._network._asdict().items():
        np.testing.assert_array_equal(value, getattr(policies[1]._network, name))
    shipped = open_agent(SHIPPED).make(context)._network
    assert not np.array_equal(shipped.last, policies[0]._network.last)
    with pytest.raises(ValueError, match="holds a training with other options"):
        fine_tuning.train(options(tmp_path / "whole", "--rate 1e-3"))
    rows = (tmp_path / "whole" / "curve.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == ",".join(fine_tuning.COLUMNS)
    assert len(rows) == 3


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (f"--agent {shipped_agents(TORQUE_ID)['mpc-learned-observer'][0]}", "no policy for any"),
        ("--agent nowhere.zip", "no such file"),
        (f"--agent {SHIPPED} --chunk 0", "--chunk = 0; must be above 0"),
        (f"--agent {SHIPPED} --seed -1", "--seed = -1; must be at least 0"),
    ],
)
def test_what_makes_no_sense_is_one_line_and_leaves_no_folder(words, says, tmp_path, capsys):
    arguments = [*words.split(), "--output", str(tmp_path / "new")]
    try:
        status = fine_tuning.main(arguments, "fine_tuning")
    except SystemExit as ended:  # of the parser
        status = ended.code
    assert status == 2
    assert says in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "new").exists()
