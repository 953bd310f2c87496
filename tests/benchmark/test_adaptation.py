"""Frozen policies: what was learned before a change is kept, and nothing is learned after it."""

import numpy as np
import pytest

from baselines.learned.agent_policy import Actor, AgentPolicy
from baselines.registry import POLICIES
from tests.baselines.learned.test_forward_pass import random_weights
from tests.benchmark.stub_policies import Constant, entry
from tracked_env.benchmark import BenchmarkConfig, Store, load_policy, run
from tracked_env.benchmark.executors import received, sent
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import frozen
from tracked_env.benchmark.runner import drive
from tracked_env.observation import SIZE

PAYLOAD = BenchmarkConfig(sets=("payload",), episodes=2, duration=6.0)


def shipped(agent):
    return policies_for("torque", [agent])[0]


def remembering(context):
    """An agent with an LSTM of random weights, which corrects `adaptive` a little."""
    network = {"inputs": SIZE + 32, "hidden": [16], "activation": "tanh"}
    actor = Actor("recurrent-ppo", *random_weights("recurrent-ppo", network))
    return AgentPolicy(actor, "residual", {"scale": 0.05}, context)


def both(folder, entries, config):
    """Records without the time, by policy."""
    given = [one for each in entries for one in (each, frozen(each))]
    found = {}
    for record in run(config, given, Store(folder, config.identity())):
        kept = {k: v for k, v in record.items() if k not in ("policy", "predict_time")}
        found.setdefault(record["policy"], []).append(kept)
    return found


def test_a_policy_without_memory_is_unchanged_to_the_bit_where_it_is_frozen(tmp_path):
    given = [entry("constant", lambda context: Constant()), shipped("ppo-blind")]
    given.append(load_policy("nominal", POLICIES))
    found = both(tmp_path, given, PAYLOAD)
    assert found["constant"] == found["constant frozen"]
    assert found["nominal"] == found["nominal frozen"]
    assert found["ppo-blind@0"] == found["ppo-blind frozen@0"]


def test_a_policy_with_memory_is_another_one_after_the_change_and_not_before(tmp_path):
    given = [load_policy("adaptive", POLICIES), shipped("ppo-estimates")]
    given.append(entry("recurrent", remembering))
    found = both(tmp_path, given, PAYLOAD)
    for own, other in zip(list(found.values())[::2], list(found.values())[1::2], strict=True):
        assert [r["digest"] for r in own] == [r["digest"] for r in other]
        assert all(
            a["rmse_after_change"] != b["rmse_after_change"]
            for a, b in zip(own, other, strict=True)
        )


def drawn(policy, config, freeze_at):
    """The actions (T, n, 2) of a policy that is frozen at these steps."""
    env = config.environment(config.sets[0], 2, truth=False)
    at = None if freeze_at is None else np.array(freeze_at)
    trace, _ = drive(policy, env, [0, 1], lambda: None, freeze_at=at)
    env.close()
    return np.stack([trace.channel("action_left"), trace.channel("action_right")], axis=-1)


def spied(policy, look):
    """The policy, and what `look(policy)` is after each of its calls."""
    seen = []
    original = policy.predict

    def predict(*given, **options):
        answer = original(*given, **options)
        seen.append(np.array(look(policy)))
        return answer

    policy.predict = predict
    return policy, seen


@pytest.mark.parametrize(
    ("make", "look", "env"),
    [
        ("adaptive", lambda p: p.controller.parameters.T, "payload"),
        ("mpc-adaptive", lambda p: p.controller.parameters.T, "payload"),
        ("l1", lambda p: p.controller.lacking, "payload"),
        ("mrac", lambda p: p.controller.parameters.T, "payload"),
        ("slc-adaptive", lambda p: p.estimator.friction, "friction-step"),
        ("mpc-adaptive", lambda p: p.estimator.friction, "friction-step"),
        ("recurrent", lambda p: (p._frozen or p._last_call)[-1][0], "payload"),
    ],
)
def test_what_was_learned_before_the_change_is_kept_in_the_frozen_row_alone(make, look, env):
    config = BenchmarkConfig(sets=(env,), episodes=2, duration=3.0)
    chosen = entry(make, remembering) if make == "recurrent" else load_policy(make, POLICIES)
    context = config.context(env)
    free, learned = spied(chosen.make(context), look)
    usual = drawn(free, config, None)
    held, kept = spied(chosen.make(context), look)
    other = drawn(held, config, [-1, 60])
    assert np.array_equal(usual[:60], other[:60])
    assert np.array_equal(usual[:, 0], other[:, 0])  # the other row learns on, to the bit
    assert not np.array_equal(usual[60:, 1], other[60:, 1])
    before, after = learned[59][1], np.array([row[1] for row in kept[60:]])
    assert np.array_equal(after, np.broadcast_to(before, after.shape))
    assert not np.array_equal(learned[-1][1], before)


def test_the_frozen_one_is_a_policy_of_its_own_name_seed_by_seed_and_in_other_processes():
    assert frozen(shipped("ppo-blind")).name == "ppo-blind frozen@0"
    twin = frozen(load_policy("adaptive", POLICIES)._replace(source=None))
    assert twin.name == "adaptive frozen" and twin.frozen
    config = BenchmarkConfig(sets=("payload",), episodes=1)
    assert received(sent(config, [twin]), twin.name).frozen
    usual = load_policy("adaptive", POLICIES)._replace(source=None)
    assert not received(sent(config, [usual]), usual.name).frozen
