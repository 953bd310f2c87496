"""The predictive policies in closed loop, by torques and by sprocket speeds."""

from functools import cache

import numpy as np
import pytest

from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.pose_filter import ATTITUDE
from baselines.registry import BY_DRIVE, POLICIES, PREDICTIVE
from tests.baselines.episodes import FAILED, context, interquartile_mean, run
from tracked_env import SPEED
from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark.policy_interface import needs_truth
from tracked_env.observation import V0
from tracked_env.sensors import PRESETS

INDOORS = PolicyContext(0.02, "sliding", PRESETS["mocap"], "speed", "focchi")
SEED = 50_000  # of a split on which nothing is published


@cache
def by_torque(name, uncertainty="soil-and-mass", **options):
    return run(POLICIES[name](context()), uncertainty, 16, seed=SEED, **options)


@cache
def by_speed(name, uncertainty="friction", gains=None):
    given = {key: SPEED[key] for key in ("vehicle", "plant", "drive", "error_limit", "reference")}
    policy = POLICIES[name](INDOORS, **(gains._asdict() if gains else {}))
    return run(policy, uncertainty, 12, sensors="mocap", seed=SEED, **given)


@pytest.mark.parametrize("uncertainty", ["soil-and-mass", "slow-drive"])
def test_it_tracks_closer_than_feedback_linearization_on_the_same_estimates(uncertainty):
    """By 8 to 10 per cent, after the start by 4, since the gains of the law are tuned as well."""
    mine, other = (by_torque(name, uncertainty) for name in ("mpc-adaptive", "adaptive"))
    assert interquartile_mean(mine.rmse) < 0.95 * interquartile_mean(other.rmse)
    assert np.median(mine.settled) < np.median(other.settled)
    assert (mine.rmse < FAILED).all()


def test_its_parameters_matter():
    known, told, wrong = (by_torque(name) for name in ("mpc-adaptive", "mpc-oracle", "mpc-nominal"))
    assert np.median(wrong.settled) > 3.0 * np.median(known.settled)
    assert interquartile_mean(known.rmse) < 1.15 * interquartile_mean(told.rmse)


def test_with_a_second_between_poses_it_stays_on_the_path():
    mine = by_torque("mpc-adaptive", sensors="rtk-outages")
    assert not mine.over.any()


def test_it_drives_a_path_backwards():
    backwards = {"kind": "circle", "radius": 10.0, "speed": -1.5}
    mine = run(POLICIES["mpc-adaptive"](context()), "nominal", 8, reference=backwards, seed=SEED)
    assert np.median(mine.settled) < 0.03


@pytest.mark.parametrize("uncertainty", ["friction", "floor-ood"])
def test_by_sprocket_speeds_it_tracks_closer_than_the_law_with_the_gains_of_the_paper(uncertainty):
    mine, tuned = (by_speed(name, uncertainty) for name in ("mpc-adaptive", "slc-adaptive"))
    paper = by_speed("slc-adaptive", uncertainty, LyapunovGains())
    assert interquartile_mean(mine.rmse) < 0.8 * interquartile_mean(paper.rmse)
    assert np.median(mine.settled) < 0.6 * np.median(paper.settled)
    assert interquartile_mean(mine.rmse) < 1.1 * interquartile_mean(tuned.rmse)  # level with it


def test_by_sprocket_speeds_knowledge_of_the_slip_matters():
    known, told, wrong = (by_speed(name) for name in ("mpc-adaptive", "mpc-oracle", "mpc-nominal"))
    assert np.median(wrong.settled) > 1.5 * np.median(known.settled)
    assert np.median(known.settled) < 1.5 * np.median(told.settled)


@pytest.mark.parametrize("name", PREDICTIVE)
def test_each_is_made_for_either_drive_and_only_the_oracle_is_told_the_truth(name):
    for given in (context(), INDOORS):
        assert name in BY_DRIVE[given.drive]
        assert needs_truth(POLICIES[name](given)) == (name == "mpc-oracle")


@pytest.mark.parametrize("name", PREDICTIVE)
def test_what_it_cannot_predict_is_refused_in_one_line(name):
    with pytest.raises(ValueError, match=r"lateral = 'constrained'; model predictive control"):
        POLICIES[name](context(lateral="constrained"))
    slopes = (*V0.names, *ATTITUDE)
    with pytest.raises(ValueError, match="predicts level ground alone"):
        POLICIES[name](INDOORS._replace(observation=slopes))


@pytest.mark.parametrize("name", PREDICTIVE)
@pytest.mark.parametrize("group", ["look_ahead", "action"])
def test_an_observation_without_what_it_needs_is_refused_by_the_group(name, group):
    shown = tuple(
        n for n in V0.names if not ("ahead_" in n if group == "look_ahead" else "previous" in n)
    )
    with pytest.raises(ValueError, match=f"'{group}'|{group}"):
        POLICIES[name](context()._replace(observation=shown))
    if group == "look_ahead":
        with pytest.raises(ValueError, match=group):
            POLICIES[name](INDOORS._replace(observation=shown))


def test_settings_are_those_that_the_factory_is_given():
    policy = POLICIES["mpc-adaptive"](context(), effort=7.0)
    assert policy.controller.settings.effort == 7.0
    with pytest.raises(ValueError, match="effort_of_all"):
        POLICIES["mpc-adaptive"](context(), effort_of_all=7.0)
