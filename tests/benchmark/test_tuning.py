"""The search of settings: what it finds, spends, refuses and counts."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from tracked_env.benchmark import tuning

RANGES = {"gain": (1.0, 100.0, True), "share": (0.0, 1.0, False)}
DEFAULT = {"gain": 2.0, "share": 0.9}
OPTIMUM = {"gain": 31.6, "share": 0.3}


class Given(NamedTuple):
    gain: float = 2.0
    share: float = 0.9


def bowl(refused=math.inf):
    """An objective with its optimum at OPTIMUM that refuses gains from `refused` on."""
    asked = []

    def evaluate(stage, settings):
        if settings["gain"] >= refused:
            return None
        asked.append(settings)
        point, best = tuning.scaled(RANGES, settings), tuning.scaled(RANGES, OPTIMUM)
        error = 0.01 * math.exp(5.0 * float(((point - best) ** 2).sum()))
        return tuning.Candidate(stage, settings, {"only": tuning.Outcome(error, error, 0.0, 1.0)})

    return evaluate, asked


def test_the_search_finds_the_optimum_of_a_bowl():
    evaluate, _ = bowl()
    found = list(tuning.searched(RANGES, DEFAULT, 120, evaluate))
    best = min(found, key=lambda one: one.cost)
    assert tuning.scaled(RANGES, best.settings) == pytest.approx(
        tuning.scaled(RANGES, OPTIMUM), abs=0.02
    )
    assert found[0].settings == DEFAULT and found[0].stage == "default"


def test_the_search_moves_all_settings_together_along_a_valley():
    """Rosenbrock's valley, where one setting at a time stands still."""
    ranges = {"a": (-2.0, 2.0, False), "b": (-2.0, 2.0, False)}

    def evaluate(stage, settings):
        a, b = settings.values()
        error = 0.01 * (1.0 + (1.0 - a) ** 2 + 100.0 * (b - a * a) ** 2)
        return tuning.Candidate(stage, settings, {"only": tuning.Outcome(error, error, 0.0, 1.0)})

    found = list(tuning.searched(ranges, {"a": -1.0, "b": 1.0}, 200, evaluate))
    costs = [one.cost for one in found]
    assert costs[0] == pytest.approx(0.05) and min(costs) < 0.02


@pytest.mark.parametrize("budget", [3, 4, 17, 30])
def test_the_budget_is_what_is_driven_and_nothing_is_driven_twice(budget):
    evaluate, asked = bowl()
    found = list(tuning.searched(RANGES, DEFAULT, budget, evaluate))
    assert len(found) == len(asked) == budget
    assert len({tuple(settings.values()) for settings in asked}) == budget
    assert [one.stage for one in found] == ["default"] + ["search"] * (budget - 1)


def test_settings_that_are_refused_are_not_counted_and_the_search_goes_round_them():
    evaluate, asked = bowl(refused=20.0)
    found = list(tuning.searched(RANGES, DEFAULT, 60, evaluate))
    assert len(found) == len(asked) == 60
    best = min(found, key=lambda one: one.cost).settings
    assert 15.0 < best["gain"] < 20.0


def test_a_controller_that_refuses_all_but_its_default_ends_the_search():
    evaluate, asked = bowl(refused=2.1)

    def only_default(stage, settings):
        return evaluate(stage, settings) if settings == DEFAULT else None

    assert len(list(tuning.searched(RANGES, DEFAULT, 5, only_default))) == len(asked) == 1


def test_one_setting_can_be_searched_and_every_search_is_the_same():
    ranges = {"gain": RANGES["gain"]}

    def evaluate(stage, settings):
        error = abs(math.log(settings["gain"] / 30.0)) + 0.01
        return tuning.Candidate(stage, settings, {"only": tuning.Outcome(error, error, 0.0, 1.0)})

    found = list(tuning.searched(ranges, {"gain": 5.0}, 40, evaluate))
    assert min(found, key=lambda one: one.cost).settings["gain"] == pytest.approx(30.0, rel=0.05)
    again = tuning.searched(ranges, {"gain": 5.0}, 40, evaluate)
    assert [one.settings for one in found] == [one.settings for one in again]


def test_haste_has_a_price_beyond_its_limit_and_the_curve_has_what_nothing_beats():
    def candidate(error, rate, limit=math.inf):
        return tuning.Candidate(
            "search", DEFAULT, {"s": tuning.Outcome(error, error, 0.0, rate)}, limit
        )

    assert candidate(0.1, 110.0, 100.0).cost == pytest.approx(0.1 * (1.0 + tuning.HASTY * 0.1))
    assert candidate(0.1, 100.0, 100.0).cost == pytest.approx(0.1)
    several = [candidate(*pair) for pair in ((0.3, 1.0), (0.2, 2.0), (0.25, 3.0), (0.1, 4.0))]
    assert [one.mean("rate") for one in tuning.undominated(several)] == [1.0, 2.0, 4.0]


def test_points_and_settings_are_inverse_and_stay_in_their_ranges():
    settings = tuning.unscaled(RANGES, tuning.scaled(RANGES, OPTIMUM))
    assert settings == pytest.approx(OPTIMUM, rel=1e-3)
    assert tuning.scaled(RANGES, {"gain": math.inf, "share": -1.0}).tolist() == [1.0, 0.0]
    assert tuning.unscaled(RANGES, np.array([1.5, -0.5])) == {"gain": 100.0, "share": 0.0}


def test_the_cost_is_the_geometric_mean_of_the_errors_with_a_price_on_failures():
    sets = [tuning.Outcome(0.04, 0.01, 0.0, 1.0), tuning.Outcome(0.16, 0.04, 0.02, 1.0)]

    def cost(*outcomes):
        return tuning.Candidate("search", DEFAULT, dict(enumerate(outcomes))).cost

    assert cost(sets[0]) == pytest.approx(0.02)
    assert cost(*sets) == pytest.approx(0.04 * (1.0 + tuning.LOST * 0.01))
    assert cost(sets[0]._replace(rmse=0.08), sets[1]) > cost(*sets)


def test_each_setting_is_varied_alone_but_for_those_without_a_scale():
    rows = list(tuning.varied({"gain": 10.0, "none": 0.0, "all": math.inf}))
    assert [row[:2] for row in rows] == [("gain", factor) for factor in tuning.FACTORS]
    assert rows[0] == ("gain", 0.5, {"gain": 5.0, "none": 0.0, "all": math.inf})


def declared(**attributes):
    def make(context, **settings): ...

    for name, value in attributes.items():
        setattr(make, name, value)
    return make


def test_a_policy_without_ranges_or_with_wrong_ones_is_refused():
    with pytest.raises(ValueError, match=r"'blind' declares no settings.*Is it an agent"):
        tuning.tunable("blind", declared())
    wrong = declared(TUNABLE={"gain": (0.0, 1.0, True)}, SETTINGS=Given)
    with pytest.raises(ValueError, match=r"range of gain is \[0, 1\]"):
        tuning.tunable("mine", wrong)
    other = tuning.tunable("mine", declared(TUNABLE=RANGES, SETTINGS=lambda context: Given()))
    assert tuning.default_settings(other, None) == DEFAULT
    unknown = declared(TUNABLE={"gian": (1.0, 2.0, True)}, SETTINGS=lambda context: Given())
    with pytest.raises(ValueError, match="Did you mean 'gain'"):
        tuning.default_settings(tuning.tunable("mine", unknown), None)
