"""Statistics over training seeds and episodes, against closed forms and published values."""

from itertools import combinations

import numpy as np
import pytest
from scipy.stats import bootstrap, mannwhitneyu, norm, t, trim_mean, ttest_1samp

from tracked_env.benchmark import statistics as stats

RNG = np.random.default_rng(20)


def redrawn(values, sizes=None, agent=0):
    return stats.redraw(values, stats.Redraws(sizes or [values.shape[1]]), agent)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7, 8, 9, 32, 101])
def test_the_interquartile_mean_is_the_mean_trimmed_by_a_quarter_at_each_end(count):
    values = np.random.default_rng(count).standard_cauchy(count)
    assert stats.interquartile_mean(values) == pytest.approx(trim_mean(values, 0.25), rel=1e-12)


def test_with_one_seed_it_is_the_percentile_bootstrap_of_scipy_redraw_by_redraw():
    values = RNG.exponential(size=22)
    found = redrawn(values[None])
    for ours, statistic in (
        (found.mean, np.mean),
        (found.iqm, stats.interquartile_mean),
        (found.quantile, lambda drawn: np.quantile(drawn, 0.9, method="inverted_cdf")),
    ):
        how = {"n_resamples": 5000, "method": "percentile", "vectorized": False}
        theirs = bootstrap(
            (values,), statistic, random_state=np.random.default_rng(stats.SEED), **how
        )
        assert ours[0] == pytest.approx(theirs.bootstrap_distribution, rel=1e-12)
        assert ours[1] == pytest.approx(np.full(5000, statistic(values)), rel=1e-12)
        interval = theirs.confidence_interval
        assert tuple(stats.interval(ours, 1)) == pytest.approx((interval.low, interval.high))


def test_counts_give_the_statistics_of_what_was_drawn_seeds_and_episodes_crossed():
    values = RNG.normal(size=(3, 9))
    values[1, 2] = values[0, 4]  # a tie
    draws = stats.Redraws([4, 5], resamples=50)
    found = stats.redraw(values, draws, agent=2)
    assert draws.episodes[:, :4].sum(axis=1).tolist() == [4] * 50
    for b in range(50):
        alone = np.repeat(values, found.seeds[b], 0)
        for kind, rows in enumerate((np.repeat(alone, draws.episodes[b], 1), alone)):
            drawn = rows.ravel()
            assert drawn.size == 27
            assert found.iqm[kind, b] == pytest.approx(stats.interquartile_mean(drawn))
            assert found.quantile[kind, b] == np.sort(drawn)[24]  # the 25th of 27
            assert found.mean[kind, b] == pytest.approx(drawn.mean())


def test_where_seeds_decide_the_interval_is_students_with_their_degrees_of_freedom():
    values = np.linspace(0.1, 0.5, 40)[:, None] + np.zeros((40, 25))
    low, high = stats.interval(redrawn(values).mean, 40)
    half = t.ppf(0.975, 39) * np.std(values[:, 0], ddof=1) / np.sqrt(40)
    assert (low, high) == pytest.approx((0.3 - half, 0.3 + half), abs=0.05 * half)


def test_where_episodes_decide_the_interval_is_the_percentile_interval():
    values = np.tile(RNG.exponential(size=60), (5, 1))
    found = redrawn(values)
    expected = tuple(np.quantile(found.mean[0], [0.025, 0.975]))
    assert tuple(stats.interval(found.mean, 5)) == pytest.approx(expected)
    assert tuple(stats.interval(found.mean, 1)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("seed_part", "episode_part", "least"),
    [
        *((1.0, 0.0, 0.88), (0.4, 6.0, 0.92)),
        pytest.param(0.0, 6.0, 0.92, marks=pytest.mark.slow),
    ],
)
def test_intervals_over_five_seeds_cover_what_they_say(seed_part, episode_part, least):
    rng = np.random.default_rng(3)
    draws = stats.Redraws([40], resamples=400)
    covered = []
    for trial in range(400):
        values = seed_part * rng.normal(size=(5, 1)) + episode_part * rng.normal(size=40)
        low, high = stats.interval(stats.redraw(values, draws, trial).mean, 5)
        covered.append(low <= 0.0 <= high)
    assert least <= np.mean(covered) <= 0.985


def test_the_degrees_of_freedom_of_two_agents_are_those_of_the_one_with_fewer_seeds():
    one, three, five = (redrawn(RNG.normal(size=(n, 8))) for n in (1, 3, 5))
    assert [stats.fewest(one), stats.fewest(one, five), stats.fewest(five, three)] == [1, 5, 3]


def test_the_hardness_of_an_episode_cancels_between_agents_and_seeds_do_not():
    hardness = RNG.exponential(5.0, 50)
    one, two = (
        stats.redraw(hardness[None] + c, stats.Redraws([50]), a) for a, c in ((0, 1.0), (1, 0))
    )
    assert (one.mean - two.mean) == pytest.approx(1.0)
    seeds = RNG.normal(size=(5, 1)) + np.zeros((5, 50))
    first, second = (stats.redraw(seeds, stats.Redraws([50]), agent) for agent in (0, 1))
    assert np.var(first.mean[0] - second.mean[0]) == pytest.approx(
        2.0 * first.mean[0].var(), rel=0.1
    )


def test_one_value_in_ten_is_beyond_the_quantile():
    assert stats.quantile(RNG.permutation(np.arange(1.0, 101.0))) == 90.0
    assert [stats.quantile(np.arange(1.0, n + 1.0)) for n in (3, 10, 11, 32)] == [3, 9, 10, 29]
    sample = np.random.default_rng(1).normal(size=200_000)
    assert stats.quantile(sample) == pytest.approx(norm.ppf(0.9), rel=0.01)


def test_the_probability_of_improvement_is_mann_whitneys_u_over_the_pairs():
    x, y = RNG.integers(0, 4, (5, 30)).astype(float), RNG.integers(0, 5, (6, 30)).astype(float)
    expected = [mannwhitneyu(y[:, n], x[:, n]).statistic / 30 for n in range(30)]
    draws = stats.Redraws([30])
    found = stats.improvement(stats.redraw(x, draws, 0), stats.redraw(y, draws, 1), draws)
    assert found.value == pytest.approx(np.mean(expected))
    back = stats.improvement(stats.redraw(y, draws, 1), stats.redraw(x, draws, 0), draws)
    assert found.value + back.value == pytest.approx(1.0)
    assert found.low < found.value < found.high
    assert (found.low, found.high) == pytest.approx((1.0 - back.high, 1.0 - back.low))


def test_the_interval_of_the_probability_is_that_of_a_share_when_seeds_do_not_matter():
    first = np.where(np.arange(400) < 280, 0.0, 2.0)[None]
    draws = stats.Redraws([400])
    found = stats.improvement(
        stats.redraw(first, draws, 0), stats.redraw(np.ones((1, 400)), draws, 1), draws
    )
    half = norm.ppf(0.975) * np.sqrt(0.7 * 0.3 / 400)
    assert found == pytest.approx((0.7, 0.7 - half, 0.7 + half), abs=0.004)


def test_a_performance_profile_is_the_empirical_distribution_with_a_band_around_it():
    values = RNG.exponential(size=(4, 60))
    tau = np.array([0.0, 0.5, 1.0, 2.0, 1e3])
    draws = stats.Redraws([60])
    share, low, high = stats.profile(stats.redraw(values, draws), draws, tau)
    assert share == pytest.approx([(values <= t).mean() for t in tau])
    assert np.all(np.diff(share) >= 0)
    assert np.all((low <= share) & (share <= high))
    assert np.all(low[1:4] < high[1:4])
    assert (low[-1], high[-1]) == (1.0, 1.0)


def test_the_score_is_the_part_of_the_gap_and_there_is_none_without_a_certain_gap():
    base = np.linspace(0.04, 0.06, 16)
    draws = stats.Redraws([16])
    low, high, mine = (stats.redraw(f * base[None], draws) for f in (3.0, 1.0, 1.5))
    found = stats.score(low, high, mine)
    assert found == pytest.approx((0.75, 0.75, 0.75))
    assert stats.score(high, low, mine) is None
    assert stats.score(low, low, mine) is None


def test_the_ratio_to_a_policy_without_any_error_is_infinite():
    assert stats.ratio(np.array([1.0, 2.0]), np.array([0.0, 4.0])).tolist() == [np.inf, 0.5]


def test_sets_of_one_size_are_redrawn_together():
    """Copies of a set say nothing that the set does not say already."""
    values = RNG.exponential(size=(2, 20))
    one, three = redrawn(values), redrawn(np.tile(values, 3), [20, 20, 20])
    assert three.mean == pytest.approx(one.mean)
    assert three.quantile[1] == pytest.approx(one.quantile[1])
    draws = stats.Redraws([20, 30, 20])
    assert np.array_equal(draws.episodes[:, :20], draws.episodes[:, 50:])
    assert not np.array_equal(draws.episodes[:, :20], draws.episodes[:, 20:40])


def test_a_set_without_episodes_is_refused():
    with pytest.raises(ValueError, match="no episodes"):
        stats.Redraws([3, 0])


def test_the_relative_error_is_the_geometric_mean_of_the_ratios_and_its_own_reference_is_one():
    draws = stats.Redraws([16])
    base = [stats.redraw(RNG.uniform(0.1, 0.2, (1, 16)), draws, 0) for _ in range(3)]
    factors = (0.5, 1.0, 4.0)
    pairs = [
        (stats.redraw(f * of.values, draws, 1), of) for f, of in zip(factors, base, strict=True)
    ]
    found = stats.relative_error(pairs)
    assert tuple(found) == pytest.approx((2.0 ** (1.0 / 3.0),) * 3)  # the same episodes: certain
    assert tuple(stats.relative_error([(of, of) for of in base])) == pytest.approx((1.0, 1.0, 1.0))


def test_the_relative_error_of_redraws_is_that_of_an_independent_bootstrap_of_all_sets():
    shape = (5, 24)
    agents = [RNG.lognormal(size=shape) for _ in range(3)]
    others = [RNG.lognormal(size=(1, 24)) for _ in range(3)]
    draws = stats.Redraws([24], resamples=40)
    pairs = [
        (stats.redraw(a, draws, 1), stats.redraw(b, draws, 0))
        for a, b in zip(agents, others, strict=True)
    ]
    seeds, logs = draws.seeds(5, 1), np.zeros((2, 40))
    for b in range(40):
        rows = np.repeat(np.arange(5), seeds[b])
        for kind, columns in enumerate((np.repeat(np.arange(24), draws.episodes[b]), range(24))):
            for agent, other in zip(agents, others, strict=True):
                drawn = agent[np.ix_(rows, columns)].ravel(), other[:, columns].ravel()
                logs[kind, b] += np.subtract(*np.log([trim_mean(x, 0.25) for x in drawn])) / 3.0
    found = stats.relative_error(pairs)
    assert (found.low, found.high) == pytest.approx(tuple(np.exp(stats.interval(logs, 5))))
    alone = [np.log(trim_mean(of, 0.25, axis=None)) for of in (*agents, *others)]
    assert found.value == pytest.approx(np.exp((sum(alone[:3]) - sum(alone[3:])) / 3.0))


@pytest.mark.parametrize(
    ("seeds", "spread", "least"),
    [pytest.param(1, 0.0, 0.91, marks=pytest.mark.slow), (5, 0.1, 0.90)],
)
def test_the_interval_of_the_relative_error_covers_what_it_says(seeds, spread, least):
    # Episode k is as hard in every set (sigma 0.5), what else differs is of its own (sigma 0.3);
    # the agent's errors are 0.8 of the reference's, times what its seed makes of them in all sets.
    rng, covered = np.random.default_rng(8), []
    draws = stats.Redraws([32], resamples=300)
    for trial in range(200):
        hardness = 0.5 * rng.normal(size=32)
        seed = spread * rng.normal(size=(seeds, 1))
        pairs = []
        for _ in range(4):
            agent = np.exp(seed + hardness + 0.3 * rng.normal(size=(seeds, 32)))
            other = np.exp(hardness + 0.3 * rng.normal(size=(1, 32)))
            pairs.append((stats.redraw(0.8 * agent, draws, 2 * trial), stats.redraw(other, draws)))
        _, low, high = stats.relative_error(pairs)
        covered.append(low <= 0.8 <= high)
    assert least <= np.mean(covered) <= 0.99


def constant_ratios(factors, count=16, seeds=1):
    """(agent, reference) of sets in each of which every episode has the same ratio."""
    draws = stats.Redraws([count])
    base = np.random.default_rng(5).lognormal(size=(1, count))
    return [
        (stats.redraw(f * np.repeat(base, seeds, axis=0), draws, 1), stats.redraw(base, draws))
        for f in factors
    ]


def test_on_sets_like_these_the_error_is_as_certain_as_students_t_over_the_sets_says():
    factors = np.exp(np.random.default_rng(2).normal(-0.2, 0.3, size=12))
    pairs, logs = constant_ratios(factors), np.log(factors)
    on_these = stats.relative_error(pairs)
    assert on_these == pytest.approx((np.exp(logs.mean()),) * 3)  # no episode differs
    value, low, high = stats.relative_error(pairs, redraw_sets=True)
    half = t.ppf(0.975, 11) * logs.std(ddof=1) / np.sqrt(12.0)
    assert value == on_these.value
    ends = logs.mean() - half, logs.mean() + half
    assert np.log([low, high]) == pytest.approx(ends, abs=0.05 * half)
    plain = bootstrap((logs,), np.mean, method="percentile", rng=np.random.default_rng(1))
    assert low < np.exp(plain.confidence_interval.low) < value  # that covers 91 % with 12 sets


def test_with_the_sets_redrawn_the_interval_holds_that_of_these_sets():
    draws = stats.Redraws([24])
    pairs = [
        (stats.redraw(RNG.lognormal(size=(5, 24)), draws, 1), stats.redraw(base, draws))
        for base in RNG.lognormal(size=(6, 1, 24))
    ]
    these, like = stats.relative_error(pairs), stats.relative_error(pairs, redraw_sets=True)
    assert like.low < these.low < these.value == like.value < these.high < like.high
    one = pairs[:1]  # one set cannot be redrawn
    assert stats.relative_error(one, redraw_sets=True) == pytest.approx(stats.relative_error(one))


@pytest.mark.slow
def test_the_interval_on_sets_like_these_covers_the_mean_of_all_sets():
    rng, covered, draws = np.random.default_rng(9), [], stats.Redraws([16], resamples=300)
    for _ in range(200):
        hardness, pairs = 0.5 * rng.normal(size=16), []
        for effect in 0.2 * rng.normal(size=10):
            agent, other = np.exp(hardness + 0.3 * rng.normal(size=(2, 1, 16)))
            pairs.append((stats.redraw(np.exp(effect) * agent, draws), stats.redraw(other, draws)))
        _, low, high = stats.relative_error(pairs, redraw_sets=True)
        covered.append(low <= 1.0 <= high)
    assert 0.92 <= np.mean(covered) <= 1.0


def test_the_relative_error_of_another_statistic_is_the_geometric_mean_of_its_ratios():
    values = np.random.default_rng(6).lognormal(size=(3, 2, 1, 30))
    draws = stats.Redraws([30])
    pairs = [(stats.redraw(a, draws), stats.redraw(b, draws)) for a, b in values]
    for name, of in (("mean", np.mean), ("quantile", lambda x: np.sort(x.ravel())[26])):
        ratios = [of(a) / of(b) for a, b in values]
        found = stats.relative_error(pairs, name)
        assert found.value == pytest.approx(np.prod(ratios) ** (1.0 / 3.0))
        assert found.low < found.value < found.high
    # One set: scipy redraws agent and reference on the same episodes.
    (a,), (b,) = values[0]
    theirs = bootstrap(
        (a, b),
        lambda x, y, axis: x.mean(axis) / y.mean(axis),
        **{"paired": True, "method": "percentile", "rng": np.random.default_rng(3)},
    ).confidence_interval
    assert stats.relative_error(pairs[:1], "mean")[1:] == pytest.approx(tuple(theirs), rel=0.03)


def test_the_p_value_is_the_level_at_which_the_interval_ends_at_one():
    rng, draws = np.random.default_rng(7), stats.Redraws([24])
    for seeds in (1, 5):
        base = rng.lognormal(size=(1, 24))
        noise = rng.normal(0.0, 0.2, (seeds, 1)) * (seeds > 1) + rng.normal(0.2, 0.4, (seeds, 24))
        pairs = [(stats.redraw(base * np.exp(noise), draws, 1), stats.redraw(base, draws))]
        p = stats.p_value(pairs)
        logs = np.log(pairs[0][0].iqm) - np.log(pairs[0][1].iqm)
        assert 0.002 < p < 0.9
        assert stats.interval(logs, seeds, level=1.0 - p)[0] == pytest.approx(0.0, abs=2e-3)
    assert stats.p_value([(pairs[0][1], pairs[0][1])]) == 1.0
    assert stats.p_value(constant_ratios([0.5])) == 1.0 / stats.RESAMPLES


def test_where_seeds_decide_and_no_redraw_is_beyond_one_the_p_value_is_students():
    logs = np.array([-0.5, -0.4, -0.3, -0.45, -0.6])
    draws, base = stats.Redraws([32]), np.ones((1, 32))
    agent = stats.redraw(np.exp(logs)[:, None] * base, draws, 1)
    p, spread = stats.p_value([(agent, stats.redraw(base, draws))]), np.log(agent.iqm[0]).std()
    ratio = np.log(stats.interquartile_mean(agent.values.ravel())) / spread
    assert p == pytest.approx(2.0 * t.cdf(ratio / np.sqrt(1.25), 4))
    assert p == pytest.approx(ttest_1samp(logs, 0.0).pvalue, abs=0.002)  # of the mean of the seeds


def test_holms_correction_is_that_of_his_paper_and_of_all_intersections():
    assert stats.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert stats.holm([]) == [] and stats.holm([0.6, 0.7]) == [1.0, 1.0]
    # Closed testing: a hypothesis is rejected with every intersection that holds it, each by
    # Bonferroni's inequality.
    p = np.random.default_rng(4).uniform(size=6) ** 3
    expected = [
        max(
            min(size * min(p[list(of)]), 1.0)
            for size in range(1, 7)
            for of in combinations(range(6), size)
            if i in of
        )
        for i in range(6)
    ]
    assert stats.holm(p.tolist()) == pytest.approx(expected)


@pytest.mark.slow
def test_of_boards_of_equal_policies_at_most_one_in_twenty_calls_one_of_them_different():
    rng, draws, alone, corrected = np.random.default_rng(1), stats.Redraws([32], 1000), 0, 0
    for _ in range(400):
        hardness = 0.5 * rng.normal(size=32)
        agents = [
            stats.redraw(np.exp(hardness + 0.3 * rng.normal(size=(1, 32))), draws) for _ in range(9)
        ]
        p_values = [stats.p_value([(agent, agents[0])]) for agent in agents[1:]]
        alone += min(p_values) <= 0.05
        corrected += min(stats.holm(p_values)) <= 0.05
    assert corrected <= 0.05 * 400 < 0.15 * 400 < alone


def test_kendalls_tau_of_one_order_of_its_reverse_and_of_nothing_to_order():
    assert stats.kendalls_tau([1, 2, 3], [10, 20, 30]) == 1.0
    assert stats.kendalls_tau([1, 2, 3], [3, 2, 1]) == -1.0
    assert np.isnan(stats.kendalls_tau([1.0], [1.0]))
