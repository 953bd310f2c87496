"""Networks in NumPy: the actions of PyTorch, the same bits in any batch, bounds."""

import numpy as np
import pytest

from baselines.learned import trained_agent
from baselines.learned.agent_policy import (
    ALGORITHMS,
    LEARNED_SLIP,
    Actor,
    AgentPolicy,
    actor_shapes,
)
from baselines.registry import ANY, LEARNED, shipped_agents
from tracked_env import SPEED, TERRAIN, TERRAIN_ID
from tracked_env.benchmark import PolicyContext
from tracked_env.observation import make_layout
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import MOCAP
from tracked_env.vector_env import TrackedVehicleVectorEnv

SLOPES = {**TERRAIN, "observation": [*TERRAIN["observation"], "height_scan"]}
SHOWN = make_layout(SLOPES["observation"]).names
INDOORS = PolicyContext(0.02, "sliding", MOCAP, "speed", VEHICLES["focchi"])
CONTEXTS = {
    "torque": PolicyContext(0.02, "sliding"),
    "speed": INDOORS,
    TERRAIN_ID: INDOORS._replace(observation=SHOWN),
}
OPTIONS = {
    "torque": {"uncertainty": "mixed"},
    "speed": SPEED,
    TERRAIN_ID: {**SLOPES, "uncertainty": "hills"},
}
# That act themselves: a learned observer has tests of its own.
FAMILIES = [
    (drive, name)
    for drive in CONTEXTS
    for name in shipped_agents(drive)
    if name not in (LEARNED, ANY)  # networks of their own
]
NETWORKS = [
    {"inputs": 31, "hidden": [64, 64], "activation": "tanh"},
    {"inputs": 40, "hidden": [16, 8, 24], "activation": "relu"},
    {"inputs": 5, "hidden": [], "activation": "tanh"},
]


def random_weights(algorithm, network, seed=0):
    """Architecture and random weights of the size that training gives them."""
    network = {**network, "lstm_hidden": 12 if algorithm == "recurrent-ppo" else None}
    random = np.random.default_rng(seed)
    shapes = actor_shapes(algorithm, network)
    weights = {
        name: (random.normal(size=shape) / np.sqrt(shape[-1])).astype(np.float32)
        for name, shape in shapes.items()
    }
    return network, weights


def inputs(network, steps=40, count=4, seed=1):
    """A sequence (T, N, D) of observations and the rows whose episodes start (T, N)."""
    random = np.random.default_rng(seed)
    shown = 2.0 * random.normal(size=(steps, count, network["inputs"])).astype(np.float32)
    return shown, random.random((steps, count)) < 0.1


def actions(model, shown, starts):
    state, acted = None, []
    for observation, start in zip(shown, starts, strict=True):
        action, state = model.predict(observation, state, start, deterministic=True)
        acted.append(np.array(action))
    return np.array(acted)


@pytest.mark.parametrize("network", NETWORKS, ids=["two-layers", "three-layers", "no-layer"])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_actor_acts_as_the_policy_of_stable_baselines3(algorithm, network):
    networks = pytest.importorskip("agents.archive", reason="the reference needs the extra `rl`")
    network, weights = random_weights(algorithm, network)
    theirs = networks.build(algorithm, network, weights)
    assert {name: value.shape for name, value in networks.weights_of(theirs).items()} == (
        actor_shapes(algorithm, network)
    )
    shown, starts = inputs(network)
    expected = actions(theirs, shown, starts)
    assert np.ptp(expected) > 0.5
    found = actions(Actor(algorithm, network, weights), shown, starts)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-5)


def with_torch(path, context):
    """The agent of an archive with networks of PyTorch."""
    networks = pytest.importorskip("agents.archive", reason="the reference needs the extra `rl`")
    recipe = trained_agent.read_recipe(path)
    kind, options = recipe["augmentation"], recipe["augmentation_options"]
    model, scaling = networks.load_network(path, recipe), trained_agent.normalisation_of(recipe)
    return AgentPolicy(model, kind, options, context, scaling)


TRAINED = [f for f in FAMILIES if f[0] != TERRAIN_ID and f[1] != LEARNED_SLIP]


@pytest.mark.parametrize(("drive", "name"), TRAINED)
def test_a_shipped_agent_acts_over_an_episode_as_with_pytorch(drive, name):
    path, context = shipped_agents(drive)[name][0], CONTEXTS[drive]
    ours, theirs = trained_agent.open_agent(path).make(context), with_torch(path, context)
    env = TrackedVehicleVectorEnv(3, **OPTIONS[drive], duration=4.0, autoreset_mode="SameStep")
    observation, _ = env.reset(seed=11)
    start, state, their_state = np.ones(3, dtype=bool), None, None
    largest = 0.0
    for _ in range(210):  # an episode, and the start of the next one
        action, state = ours.predict(observation, state, start)
        expected, their_state = theirs.predict(observation, their_state, start)
        largest = max(largest, float(np.abs(action - expected).max()))
        observation, _, terminated, truncated, _ = env.step(action)
        start = terminated | truncated
    assert largest < 1e-5


@pytest.mark.parametrize(("drive", "name"), FAMILIES)
def test_a_shipped_agent_drives_a_row_of_a_batch_as_one_vehicle(drive, name):
    path = shipped_agents(drive)[name][0]
    options = OPTIONS[drive]

    def commands(count, seed):
        env = TrackedVehicleVectorEnv(count, **options)
        policy = trained_agent.open_agent(path).make(CONTEXTS[drive])
        observation, _ = env.reset(seed=seed)
        state, acted = None, []
        for _ in range(100):
            action, state = policy.predict(observation, state)
            acted.append(action)
            observation = env.step(action)[0]
        return np.array(acted)

    together = commands(3, 5)
    np.testing.assert_array_equal(together[:, 1:2], commands(1, 6))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_actions_stay_within_their_bounds(algorithm):
    network, weights = random_weights(algorithm, NETWORKS[0])
    strong = {name: 50.0 * value for name, value in weights.items()}
    shown, starts = inputs(network)
    found = actions(Actor(algorithm, network, strong), 100.0 * shown, starts)
    assert np.isfinite(found).all()
    assert np.abs(found).max() == 1.0
