"""The error over the reference's: what a lost set does to it, and other orders."""

from typing import Any

import numpy as np
import pytest

from tests.benchmark.test_report import EASY, records
from tracked_env.benchmark import relative_errors as re
from tracked_env.benchmark.summary import Row, rows_of

LIMIT = 5.0  # [m] error of a lost episode


def rows(count: int = 12, lost: int = 0, share: float = 1.0, **factors: float) -> dict[str, Row]:
    """Rows of `count` sets; of the first `lost`, a share of the episodes is lost by `x`."""
    given: list[dict[str, Any]] = []
    for number in range(count):
        errors = {name: factor * EASY for name, factor in factors.items()}
        gone = np.arange(len(EASY)) < (share * len(EASY) if number < lost else 0)
        errors["x"] = np.where(gone, LIMIT, errors["x"])
        for record in records(f"set{number}", **errors):
            failed = record["policy"] == "x" and gone[record["episode"]]
            settled = record["tracking_rmse"] / 2.0
            given.append({**record, "success": float(not failed), "settled_rmse": settled})
    return {name: row for name, row in rows_of(given).items() if name.startswith("set")}


def test_the_same_factor_in_a_set_of_small_and_of_large_errors_counts_the_same() -> None:
    given = records("small", adaptive=EASY, x=2.0 * EASY, y=EASY)
    given += records("large", adaptive=9.0 * EASY, x=9.0 * EASY, y=18.0 * EASY)
    sets = {name: row for name, row in rows_of(given).items() if name in ("small", "large")}
    found = [re.relative(sets, name, "adaptive") for name in ("x", "y")]
    assert tuple(found[0].whole) == pytest.approx((2.0**0.5,) * 3)
    assert tuple(found[1].whole) == pytest.approx((2.0**0.5,) * 3)
    assert [of.worst_set for of in found] == ["small", "large"]
    assert [of.worst for of in found] == pytest.approx([2.0, 2.0])


def test_one_lost_set_of_twelve_makes_the_mean_half_as_large_again_and_is_named() -> None:
    good, bad = (re.relative(rows(lost=n, adaptive=1.0, x=1.0), "x", "adaptive") for n in (0, 1))
    assert good.whole.value == pytest.approx(1.0)
    assert bad.whole.value == pytest.approx((LIMIT / 0.05) ** (1.0 / 12.0)) and bad.whole.low > 1.4
    assert (bad.worst_set, bad.lost, good.lost) == ("set0", ("set0",), ())
    assert bad.worst == pytest.approx(LIMIT / 0.05)


def test_a_set_is_lost_from_more_than_half_of_the_episodes_and_where_the_reference_is_not() -> None:
    for share, lost in ((0.5, ()), (0.5625, ("set0", "set1"))):
        of = rows(count=3, lost=2, share=share, adaptive=1.0, x=1.0)
        assert re.relative(of, "x", "adaptive").lost == lost
        assert re.relative(of, "adaptive", "x").lost == ()
    both = records("a", adaptive=EASY, x=EASY)
    for record in both:
        record["success"] = 0.0
    assert re.relative(rows_of(both), "x", "adaptive").lost == ()


def test_the_order_by_another_statistic_shows_what_the_iqm_does_not() -> None:
    of = rows(count=2, lost=2, share=0.2, adaptive=1.0, x=0.9, z=3.0)
    ranked = {
        name: re.relative(of, name, "adaptive").whole.value for name in ("x", "adaptive", "z")
    }
    assert sorted(ranked, key=lambda name: ranked[name]) == ["x", "adaptive", "z"]
    found = re.agreement(of, ranked)
    assert set(found) == {*re.OTHER, "1 unlike sets"}
    assert found["median"] == found["IQM times power"] == 1.0
    assert found["mean"] == found["worst tenth"] == pytest.approx(-1.0 / 3.0)  # x is last
    assert found["success"] < 0.0


def test_energy_is_weighed_per_time_driven_so_that_an_early_end_saves_nothing() -> None:
    given = records("a", adaptive=EASY, x=EASY)
    for record in given:
        early = record["policy"] == "x"
        record |= {"energy": 100.0 if early else 300.0, "driven_time": 10.0 if early else 30.0}
    of = rows_of(given)
    by = re.OTHER["IQM times power"]
    assert by([of["a"]], "x") == pytest.approx(by([of["a"]], "adaptive"))
