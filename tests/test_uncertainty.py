"""Laws of uncertainty of one's own: in every environment, in the benchmark, and what is refused."""

from typing import NamedTuple

import gymnasium
import numpy as np
import pytest

from tests.benchmark.stub_policies import Constant
from tracked_env import uncertainty
from tracked_env.benchmark import BenchmarkConfig, BenchmarkSet, Store, check, evaluation_sets, run
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.env import TrackedVehicleEnv
from tracked_env.events import ramp_events
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sb3 import make_vec_env
from tracked_env.uncertainty import Draw
from tracked_env.vector_env import TrackedVehicleVectorEnv

ID = "tracked_env:tracked_env/Torque-v0"
ACTION = np.array([0.3, 0.2], dtype=np.float32)


def heavy_then_light(rng, nominal, profile, duration):
    """An unknown mass, a third of which falls off half-way."""
    mass = nominal.mass * rng.uniform(1.2, 1.4)
    return Draw(nominal._replace(mass=mass), ramp_events({"mass": mass / 1.5}, duration / 2, 0.0))


class Heavier(NamedTuple):
    """An object as a law, with a setting of its own."""

    factor: float

    def __call__(self, rng, nominal, profile, duration):
        return Draw(nominal._replace(mass=self.factor * nominal.mass), [])


def masses(env, count=3):
    """True masses of the first episodes."""
    return [env.reset(seed=seed)[1]["truth"]["mass"] for seed in range(count)]


def test_a_law_of_ones_own_draws_the_episodes_of_every_environment():
    arguments = {"uncertainty": heavy_then_light, "expose_truth": True, "duration": 2.0}
    single, nominal = gymnasium.make(ID, **arguments), VEHICLES["strawa"].mass
    rows = gymnasium.make_vec(ID, 3, "vector_entry_point", **arguments)
    draws = masses(single)
    assert len(set(draws)) == 3 and all(1.2 <= mass / nominal <= 1.4 for mass in draws)
    assert rows.reset(seed=0)[1]["truth"]["mass"].tolist() == draws
    single.reset(seed=0)
    for _ in range(60):
        info = single.step(ACTION)[4]
    assert info["truth"]["mass"] == pytest.approx(draws[0] / 1.5)


def test_stable_baselines3_and_mixtures_take_a_law_too():
    env = make_vec_env(n_envs=2, env_kwargs={"uncertainty": Heavier(2.0)}, seed=0)
    env.reset()
    (simulation, _) = env.get_attr("simulation")
    assert simulation.truth()["mass"].tolist() == [2900.0, 2900.0]
    mixed = TrackedVehicleEnv(
        uncertainty=[Heavier(2.0), "nominal", Heavier(3.0)], expose_truth=True
    )
    assert {mass / 1450.0 for mass in masses(mixed, 20)} == {1.0, 2.0, 3.0}


def test_a_registered_law_has_a_name(registries):
    uncertainty.register("heavy-then-light", heavy_then_light, "a third falls off")
    uncertainty.register("twice", Heavier(2.0))
    assert uncertainty.DESCRIPTIONS["heavy-then-light"] == "a third falls off"
    assert uncertainty.DESCRIPTIONS["twice"] == "An object as a law, with a setting of its own."
    named = TrackedVehicleEnv(uncertainty="heavy-then-light", expose_truth=True)
    direct = TrackedVehicleEnv(uncertainty=heavy_then_light, expose_truth=True)
    assert masses(named) == masses(direct)
    for taken in ("payload", "twice"):
        with pytest.raises(ValueError, match=f"uncertainty set '{taken}' is taken"):
            uncertainty.register(taken, heavy_then_light)


def law(value):
    """A law that draws value(nominal parameters)."""
    return lambda rng, nominal, profile, duration: value(nominal)


def changed(**values):
    """A law that draws these parameters."""
    return law(lambda nominal: Draw(nominal._replace(**values), []))


STEP = ramp_events({"mass": 1.0}, 1.0, 0.0)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (lambda rng, nominal: None, r"must take \(rng, nominal, profile, duration\): too many"),
        (law(lambda nominal: nominal), r"returned PlantParameters.*; must be Draw"),
        (law(lambda nominal: None), r"returned None; must be Draw\(parameters, events\)"),
        (law(lambda nominal: Draw(1.0, [])), r"parameters = 1\.0; must be nominal\._replace"),
        (law(lambda nominal: Draw({"mas": 1.0}, [])), r"unknown parameter 'mas'.*mean 'mass'"),
        (law(lambda nominal: Draw(nominal, [{"kind": "jump"}])), r"unknown schedule kind 'jump'"),
        (law(lambda nominal: Draw(nominal, STEP)), r"target of mass = 1\.0 kg; must be"),
        (changed(mass=-1.0), r"mass = -1\.0 kg; must be .*tonnes"),
        (changed(mass=np.nan), r"mass = nan kg; must be a number"),
        (changed(mass="1"), r"mass = '1'; must be a number"),
    ],
)
def test_a_law_that_is_wrong_is_refused_when_the_environment_is_made(given, says):
    with pytest.raises(ValueError, match=f"law .*lambda.*{says}"):
        TrackedVehicleEnv(uncertainty=given)


def test_a_draw_that_is_wrong_later_names_the_law_and_moves_nothing():
    def seldom(rng, nominal, profile, duration):
        return Draw(nominal._replace(cohesion=-1.0 if rng.random() < 0.2 else 1e3), [])

    env = TrackedVehicleVectorEnv(32, uncertainty=seldom)
    with pytest.raises(ValueError, match=r"vehicle \d+: law .*seldom: cohesion = -1\.0 Pa"):
        env.reset(seed=0)


def test_a_law_may_name_only_the_parameters_that_it_changes():
    mass = law(lambda nominal: Draw({"mass": 2000}, []))
    env = TrackedVehicleEnv(uncertainty=mass, expose_truth=True)
    truth = env.reset(seed=0)[1]["truth"]
    assert (truth["mass"], truth["inertia"]) == (2000.0, VEHICLES["strawa"].inertia)


def test_the_benchmark_runs_a_set_of_ones_own_beside_those_of_the_version(registries, tmp_path):
    evaluation_sets.register(BenchmarkSet("mine", heavy_then_light))
    config = BenchmarkConfig(sets=("payload", "mine"), episodes=2, duration=1.0)
    coast = PolicyEntry("coast", lambda context: Constant(), "0")
    records = run(config, [coast], Store(tmp_path, config.identity()))
    assert [record["set"] for record in records] == ["payload"] * 2 + ["mine"] * 2
    assert "mine" not in evaluation_sets.default_sets() and "mine" not in evaluation_sets.OF_VERSION
    answer = check(BenchmarkConfig(sets=("mine",), episodes=2))
    assert not answer.comparable and "sets of your own, not torque-v4: set mine" in answer.message
    with pytest.raises(ValueError, match="evaluation set 'mine' is registered already"):
        evaluation_sets.register(BenchmarkSet("mine", "payload"))


def test_results_of_another_law_of_the_same_name_are_other_results(registries):
    plain = BenchmarkConfig(sets=("payload",)).identity()
    assert "own_sets" not in plain
    readings, ranges = [], {"mass": [1000.0, 2000.0]}
    for spec in (Heavier(2.0), Heavier(2.5), heavy_then_light, ranges, "drift"):
        evaluation_sets.SETS.pop("mine", None)
        evaluation_sets.register(BenchmarkSet("mine", spec))
        readings.append(BenchmarkConfig(sets=("mine",)).identity())
        assert readings[-1] == BenchmarkConfig(sets=("mine",)).identity()
    assert len({str(identity["own_sets"]) for identity in readings}) == 5
    assert all({**identity, "own_sets": 0} == {**plain, "own_sets": 0} for identity in readings)
