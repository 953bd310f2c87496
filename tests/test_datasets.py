"""Data sets for offline learning hold what single environments give."""

import numpy as np
import pytest

from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import POLICIES
from tracked_env.benchmark import PolicyContext
from tracked_env.env import TrackedVehicleEnv


@pytest.fixture
def minari(tmp_path, monkeypatch):
    """Minari with its data sets in a folder of the test."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return pytest.importorskip("minari")


@pytest.mark.filterwarnings("ignore:`.*` is set to None:UserWarning")
def test_a_data_set_of_the_adaptive_baseline_is_what_single_environments_give(minari):
    from tracked_env.datasets import create_dataset

    create_dataset(
        "tracked_env/payload/adaptive-v0", AdaptivePolicy(), 3, seed=7, record_truth=True,
        uncertainty="payload", duration=1.0, description={"author": "A. Author"},
    )  # fmt: skip
    dataset = minari.load_dataset("tracked_env/payload/adaptive-v0")
    assert dataset.total_episodes == 3 and dataset.total_steps == 150
    assert dataset.storage.metadata["algorithm_name"] == "AdaptivePolicy"
    env = dataset.recover_environment()
    assert env.unwrapped.simulation.config.uncertainty == "payload"
    assert env.spec.max_episode_steps == 50
    truthful = TrackedVehicleEnv(uncertainty="payload", duration=1.0, expose_truth=True)
    for i, episode in enumerate(dataset.iterate_episodes()):
        policy, state = AdaptivePolicy(), None
        observation, _ = env.reset(seed=7 + i)
        truth = [truthful.reset(seed=7 + i)[1]["truth"]["mass"]]
        for k in range(50):
            assert np.array_equal(observation, episode.observations[k])
            action, state = policy.predict(observation, state)
            assert np.array_equal(action, episode.actions[k])
            observation, reward, *_ = env.step(action)
            assert reward == episode.rewards[k]
            truth.append(truthful.step(action)[4]["truth"]["mass"])
        assert np.array_equal(observation, episode.observations[50])
        assert episode.truncations.tolist() == [False] * 49 + [True]
        assert not episode.terminations.any()
        assert np.array_equal(episode.infos["truth"]["mass"], truth)
    with pytest.raises(ValueError, match="exists already"):
        create_dataset("tracked_env/payload/adaptive-v0", AdaptivePolicy(), 3)


class Runaway:
    """Full speed for odd rows, nothing for even ones: some leave the path, others do not."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action = np.zeros((len(observation), 2), np.float32)
        action[1::2] = 5.0
        return action, state


def test_collected_episodes_end_where_they_end_and_batches_do_not_matter(minari, monkeypatch):
    from tracked_env import datasets
    from tracked_env.datasets import collect

    args = {"duration": 3.0, "error_limit": 1.5, "reference": "circle"}
    whole = collect(Runaway(), 4, seed=1, **args)
    monkeypatch.setattr(datasets, "BATCH", 2)
    parts = collect(Runaway(), 4, seed=1, **args)
    for episode, same in zip(whole, parts, strict=True):
        length = len(episode.rewards)
        assert episode.observations.shape == (length + 1, 31)
        assert episode.actions.shape == (length, 2) and np.abs(episode.actions).max() <= 1.0
        ended = episode.terminations | episode.truncations
        assert ended.tolist() == [False] * (length - 1) + [True]
        assert (episode.id, episode.seed) == (same.id, same.seed) == (episode.id, 1 + episode.id)
        assert np.array_equal(episode.observations, same.observations)
        assert episode.infos is None
    assert len({len(episode.rewards) for episode in whole}) > 1
    assert any(episode.terminations[-1] for episode in whole)
    with pytest.raises(ValueError, match="must be at least 1"):
        collect(Runaway(), 0)


def test_the_oracle_is_handed_the_truth_without_recording_it(minari):
    from tracked_env.datasets import collect

    oracle = POLICIES["oracle"](PolicyContext(0.02, "sliding"))
    (episode,) = collect(oracle, 1, duration=4.0, uncertainty="weak-soil")
    nominal = POLICIES["nominal"](PolicyContext(0.02, "sliding"))
    (other,) = collect(nominal, 1, duration=4.0, uncertainty="weak-soil")
    assert episode.infos is None
    assert np.array_equal(episode.observations[0], other.observations[0])
    assert np.sum(episode.rewards) > np.sum(other.rewards)
