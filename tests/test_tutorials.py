"""The tutorials run, and what their text says of the numbers is so."""

import re

import numpy as np
import pytest


@pytest.fixture(scope="module")
def tutorial(repository):
    """Runs the cells of a page once, in order, in one namespace; returns the namespace."""
    import matplotlib.pyplot as plt

    result = {}

    def run(page):
        if page not in result:
            text = (repository / f"docs/tutorials/{page}.md").read_text()
            cells = re.findall(r"^```\{code-cell\} ipython3\n(.*?)^```", text, re.S | re.M)
            assert len(cells) > 5
            result[page] = {"__name__": "__main__"}
            for number, cell in enumerate(cells, 1):
                exec(compile(cell, f"{page}.md, cell {number}", "exec"), result[page])
            plt.close("all")
        return result[page]

    return run


@pytest.mark.slow
def test_the_closed_loop_is_the_closed_form_and_a_wrong_mass_costs_ten_times(tutorial):
    names = tutorial("adaptive_control")
    factors, wrong, right = (names[name] for name in ("factors", "wrong", "right"))
    settled = names["settled"]
    assert np.all(settled(right) < 0.01)
    assert np.all(settled(wrong)[abs(factors - 1.0) > 0.09] > 10.0 * settled(right).max())
    straight = names["drive"](
        names["make"](
            1, uncertainty="nominal", sensors="ideal", reference=names["straight"], duration=4.0
        ),
        names["FeedbackLinearizingController"](
            names["nominal"], gains=names["TUNED_GAINS"]._replace(bound=np.inf)
        ),
        {"start": names["start"], "vehicle": {"drive_time_constant": 0.0}},
    )
    assert np.max(np.abs(straight.errors[:, 0] - np.abs(names["expected"]))) < 0.005


@pytest.mark.slow
def test_the_adaptive_controller_finds_the_load_and_its_claims_are_cautious(tutorial):
    names = tutorial("adaptive_control")
    adaptive, fixed = names["adaptive"], names["fixed"]
    after = adaptive.times > 10.3
    mass, deviation, truth = adaptive.beliefs["mass"][:, after, 0]
    assert np.all(np.abs(mass - truth) < 3.0 * deviation) and np.all(deviation < 0.1 * truth)
    assert adaptive.errors[after].mean() < 0.1 * fixed.errors[after].mean()
    for name in ("mass", "inertia", "longitudinal_resistance", "lateral_resistance"):
        value, sigma, true = names["run"].beliefs[name]
        assert 0.1 < np.mean(((value - true) / sigma) ** 2) < 1.0, name


@pytest.mark.slow
def test_pairs_make_certain_what_is_not_certain_apart(tutorial):
    names = tutorial("train_and_compare")
    error, interval, bootstrap = names["error"], names["interval"], names["bootstrap"]
    mean = np.mean
    for first, second in (("adaptive", "oracle"), ("l1", "adaptive")):
        a, b = error[first], error[second]
        low, high = interval(bootstrap(a - b, mean))
        certain = low > 0.0 or high < 0.0
        assert certain == (first == "adaptive"), "section 5 says which paired difference is certain"
        apart = interval(bootstrap(a, mean, seed=1) - bootstrap(b, mean, seed=2))
        assert apart[0] < 0.0 < apart[1], "section 5 says that the unpaired one is not"


@pytest.mark.slow
def test_trainings_of_one_agent_differ_significantly_over_episodes(tutorial):
    names = tutorial("train_and_compare")
    assert names["seeds"].shape == (5, 32)
    assert names["certain"] >= 5, "section 7 says that most pairs of trainings differ"
    result = names["summary"].policies["payload"]["ppo-blind"]
    assert result.seeds == 5
    assert 1e-3 * names["by_seed"].min() < result.rmse_iqm.value < result.rmse_iqm.high
