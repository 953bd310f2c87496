"""The adaptive policy and the oracle in closed loop, beside others and with bad samples."""

from functools import cache, partial

import numpy as np
import pytest

from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from baselines.registry import POLICIES, OraclePolicy, adaptive, nominal, oracle
from tests.baselines.episodes import FAILED, context, interquartile_mean, run
from tracked_env import benchmark
from tracked_env import observation as layout
from tracked_env.benchmark import BenchmarkConfig, PolicyEntry, Store, metrics
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT
from tracked_env.benchmark.identification_metrics import Recorder
from tracked_env.benchmark.policy_interface import tell_plant
from tracked_env.benchmark.runner import drive
from tracked_env.physics.parameters import PARAMETER_NAMES, plant_parameters
from tracked_env.sensors import CHANNELS, make_sensors

LADDER = ("nominal", "adaptive", "oracle")
PAPER = Gains()._asdict()
del PAPER["k_i"]
FACTORIES = {
    "nominal": nominal,
    "adaptive": adaptive,
    "oracle": oracle,
    "nominal of the paper": partial(nominal, **PAPER),
    "oracle of the paper": partial(oracle, **PAPER),
    # Knows all, and drives by the bare sensors.
    "unfiltered": lambda context: OraclePolicy(lateral=context.lateral, filtered=False),
}


@cache
def outcome(name, uncertainty, count=32, sensors="rtk", **changed):
    """Episodes of one policy; `changed` sensors differ from the preset."""
    preset = make_sensors(sensors)
    options = {**preset._asdict(), **changed} if changed else sensors
    return run(FACTORIES[name](context(preset)), uncertainty, count, sensors=options)


def score(name, uncertainty, count=32, **options):
    return interquartile_mean(outcome(name, uncertainty, count, **options).rmse)


def test_on_unknown_soil_with_unknown_load_it_drives_as_if_it_knew_them():
    adaptive_run, oracle_run = (score(name, "soil-and-mass", 48) for name in ("adaptive", "oracle"))
    assert adaptive_run < 1.15 * oracle_run  # 0.99: the filter makes up for what is learned late
    # 2.5 with the tuned gains; 4.9 with those of the paper, which let wrong parameters leave more
    assert score("nominal", "soil-and-mass", 48) > 2.0 * oracle_run
    blind, known = (score(f"{name} of the paper", "soil-and-mass", 48) for name in LADDER[::2])
    assert blind > 4.0 * known


SLOW = pytest.mark.slow
CHANGES = ["payload", pytest.param("terrain-transition", marks=SLOW), "drift"]


@pytest.mark.parametrize("uncertainty", [*CHANGES, pytest.param("mixed", marks=SLOW)])
def test_changes_under_way_cost_it_little_of_what_knowing_them_saves(uncertainty):
    blind, adaptive_run, oracle_run = (score(name, uncertainty) for name in LADDER)
    assert (blind - adaptive_run) / (blind - oracle_run) > 0.9  # 0.995
    late = outcome("adaptive", uncertainty).settled
    assert np.median(late) < 2.0 * np.median(outcome("oracle", uncertainty).settled)


@pytest.mark.parametrize("uncertainty", ["soil-and-mass", *CHANGES])
def test_it_never_fails_where_the_nominal_controller_does_not(uncertainty):
    count = 48 if uncertainty == "soil-and-mass" else 32
    mine, blind = (outcome(name, uncertainty, count) for name in ("adaptive", "nominal"))
    assert not ((mine.rmse > FAILED) & (blind.rmse <= FAILED)).any()
    assert not mine.over.any()


def test_where_the_nominal_parameters_are_right_nothing_is_lost():
    blind, adaptive_run = (
        score(name, "nominal", sensors="ideal") for name in ("nominal", "adaptive")
    )
    assert adaptive_run < 1.05 * blind


def test_with_the_sensors_of_the_paper_it_beats_one_who_knows_all_but_filters_nothing():
    names = ("adaptive", "unfiltered")
    mine, oracle_run = (outcome(name, "soil-and-mass", sensors="strawa") for name in names)
    assert interquartile_mean(mine.rmse) < 0.7 * interquartile_mean(oracle_run.rmse)  # 0.57
    assert np.median(mine.settled) < 0.5 * np.median(oracle_run.settled)  # 6 cm, 17 cm


@pytest.mark.parametrize(
    ("changed", "share"),
    [
        pytest.param({"pose_delay": 0.2}, 0.3, marks=SLOW),
        pytest.param({"pose_rate": 5.0}, 0.5, marks=SLOW),
        pytest.param({"drive_delay": 0.1}, 1.2, marks=SLOW),
        ({"pose_delay": 0.1, "inertial_delay": 0.1, "drive_delay": 0.1}, 0.6),
        ({"pose_dropout": 0.3, "inertial_dropout": 0.3, "drive_dropout": 0.3}, 1.1),
    ],
    ids=["late pose", "rare pose", "late drive", "late all", "dropouts"],
)
def test_slow_late_and_missing_samples_are_bridged(changed, share):
    mine = outcome("adaptive", "soil-and-mass", 48, **changed)
    oracle_run = outcome("unfiltered", "soil-and-mass", 48, **changed)
    assert interquartile_mean(mine.rmse) < share * interquartile_mean(oracle_run.rmse)
    # A start at a pose that is late or rare is hard: one vehicle in thirty spins there.
    assert np.mean(mine.rmse > FAILED) < 0.05
    assert interquartile_mean(mine.settled) < 0.1


@pytest.mark.parametrize(
    "reference",
    [
        {"kind": "straight", "speed": -1.5},
        {"kind": "circle", "radius": 8.0, "speed": -1.2},
        {"kind": "straight", "speed": -1.5, "initial_speed": 1.5},
        {"kind": "straight", "speed": 0.0, "initial_speed": 1.5},
    ],
    ids=["reverse", "reverse circle", "reversal", "to rest"],
)
def test_reverse_reversal_and_standstill_are_driven_too(reference):
    mine = run(AdaptivePolicy(), "soil-and-mass", 16, reference=reference)
    assert not mine.over.any()
    assert np.median(mine.settled) < 0.05
    assert mine.settled.max() < 0.3


def test_beside_a_resting_reference_it_comes_to_rest():
    policy = AdaptivePolicy()
    mine = run(policy, "soil-and-mass", 16, reference={"kind": "straight", "speed": 0.0})
    assert np.isfinite(mine.action).all()
    assert mine.error[-1].max() < 0.5
    for value, deviation in policy.estimates().values():
        assert np.isfinite(value + deviation).all()


def test_the_lateral_model_of_the_paper_with_its_factor_is_identified_as_well():
    p = plant_parameters()._replace(turning_resistance_factor=2.0)
    reset = {"lateral_model": {"turning_resistance_factor": 2.0}}
    options = {"lateral": "constrained", "reset": reset}
    mine = run(AdaptivePolicy(p, lateral="constrained"), "soil-and-mass", 16, **options)
    trusting, knowing = (
        kind(p, lateral="constrained") for kind in (FeedbackLinearizingController, OraclePolicy)
    )
    blind, oracle_run = (
        run(policy, "soil-and-mass", 16, **options) for policy in (trusting, knowing)
    )
    # Some in sixteen have not the torque to turn against that resistance, whoever drives.
    assert interquartile_mean(mine.rmse) < 1.15 * interquartile_mean(oracle_run.rmse)
    assert interquartile_mean(mine.rmse) < 0.25 * interquartile_mean(blind.rmse)
    assert max(mine.over.sum(), oracle_run.over.sum()) < blind.over.sum()


def test_filterpy_drives_as_the_batched_filter_does():
    runs = [
        run(AdaptivePolicy(slip=slip), "soil-and-mass", 4, 3.0) for slip in ("batched", "filterpy")
    ]
    assert np.abs(runs[0].error - runs[1].error).max() < 1e-3
    assert np.abs(runs[0].action - runs[1].action).max() < 0.01


OUTLIERS, DROPOUTS, MISSING = 0.005, 0.01, 0.005  # [-] of the samples
EPISODES, SEED = 32, 73_000
BEGUN = 1.0  # [s] the first samples of all cannot be told from what is expected
COLUMNS = [layout.INDEX[name] for name in layout.NAMES if name in CHANNELS]
TORQUES = [layout.INDEX["torque_left"], layout.INDEX["torque_right"]]
# Torques that the drives could give: no gate on the torque itself sees them.
LARGEST = plant_parameters().torque_limit / layout.SCALE[TORQUES[0]]


class Spoiled(AdaptivePolicy):
    """Sees torques that are not there and numbers that are missing."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        rng = np.random.default_rng(0) if state is None else self.rng
        self.rng, seen = rng, observation.copy()
        count = len(seen)
        wrong = rng.random((count, 2)) < OUTLIERS
        lies = rng.uniform(-LARGEST, LARGEST, (count, 2))
        seen[:, TORQUES] = np.where(wrong, lies, seen[:, TORQUES])
        gone = rng.random((count, len(COLUMNS))) < MISSING
        seen[:, COLUMNS] = np.where(gone, np.nan, seen[:, COLUMNS])
        action, state = super().predict(seen, state, episode_start, deterministic)
        assert np.isfinite(action).all()
        for value, deviation in self.estimates().values():
            assert np.isfinite(value).all() and (deviation > 0.0).all()
        return action, state


@cache
def disturbed(name, spoiled):
    """(relative errors and errors over their deviations (T, N) by parameter, tracking RMSE (N,))
    of one set, from BEGUN on."""
    lost = {f"{group}_dropout": DROPOUTS for group in ("pose", "inertial", "drive")}
    sensors = {"preset": "rtk", **lost} if spoiled else "rtk"
    config = BenchmarkConfig(sets=(name,), episodes=EPISODES, seed=SEED, sensors=sensors)
    policy = adaptive(config.context(name))
    if spoiled:
        policy.__class__ = Spoiled
    env = config.environment(name, EPISODES, truth=False)
    recorder = Recorder(EPISODES, env.simulation.settings.max_steps)
    seeds = [SEED + i for i in range(EPISODES)]
    trace, _ = drive(policy, env, seeds, lambda: None, recorder)
    rows = slice(round(BEGUN / trace.control_period), recorder.rows)
    errors = {}
    for parameter in ("mass", "inertia", "longitudinal_resistance", "lateral_resistance"):
        j = recorder.names.index(parameter)
        value, truth = recorder.value[rows, j], recorder.truth[rows, j]
        errors[parameter] = (value / truth - 1.0, (value - truth) / recorder.deviation[rows, j])
    return errors, metrics.evaluate(trace)["tracking_rmse"]


@pytest.mark.parametrize(
    ("name", "error"), [("soil-and-mass", 0.015), pytest.param("drift", 0.06, marks=SLOW)]
)
def test_outliers_dropouts_and_missing_numbers_neither_move_the_mass_nor_its_claim(name, error):
    errors, rmse = disturbed(name, True)
    clean, before = disturbed(name, False)
    assert np.median(np.abs(errors["mass"][0][-1])) < error
    for parameter, (_relative, normalised) in errors.items():
        assert np.mean(normalised**2) < 2.5, parameter
        inside, undisturbed = (np.mean(np.abs(z) < 3.0) for z in (normalised, clean[parameter][1]))
        assert inside > min(undisturbed, 0.97) - 0.01, parameter
    assert np.median(rmse) < 1.02 * np.median(before)


SHEARED = "distributed"  # the set of patches, whose shear takes up the turns


def oracle_after(name, steps=150, count=4):
    """The oracle after some steps on a set, and the truth that it was told."""
    config = BenchmarkConfig(sets=(name,))
    env = config.environment(name, count, truth=True)
    oracle = POLICIES["oracle"](config.context(name))
    tell_plant(oracle, env.simulation.solver.reads.names)
    observation, info = env.reset(seed=list(range(DEVELOPMENT, DEVELOPMENT + count)))
    state = None
    for _ in range(steps):
        truth = info["truth"]
        oracle.observe_truth(truth)
        action, state = oracle.predict(observation, state)
        observation, *_, info = env.step(action)
    env.close()
    return dict(zip(PARAMETER_NAMES, oracle.controller.parameters, strict=True)), truth


def test_where_the_plant_reads_them_all_parameters_are_the_true_ones():
    used, truth = oracle_after("soil-and-mass")
    for name in PARAMETER_NAMES:
        np.testing.assert_array_equal(used[name], truth[name], err_msg=name)


@pytest.mark.slow
def test_knowing_the_soil_of_patches_is_no_worse_than_identifying_a_lateral_resistance(tmp_path):
    config = BenchmarkConfig(sets=(SHEARED,), episodes=12, seed=DEVELOPMENT)
    entries = [PolicyEntry(name, POLICIES[name], "0") for name in ("adaptive", "oracle")]
    records = benchmark.run(config, entries, Store(tmp_path, config.identity()))
    errors = [
        np.array([r["tracking_rmse"] for r in records if r["policy"] == entry.name])
        for entry in entries
    ]
    adaptive, oracle = map(interquartile_mean, errors)
    assert oracle == pytest.approx(adaptive, rel=0.1)
