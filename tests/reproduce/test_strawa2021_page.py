"""The page of the paper: it is written, its links resolve, its verdicts follow the numbers."""

import re

import numpy as np
import pytest

from reproduce.paper_page import claims_table, terminal, verdict
from reproduce.strawa2021 import PAGE, control, page
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.identification import REGRESSIONS
from reproduce.strawa2021.page import Results

pytestmark = pytest.mark.slow

LENGTH = 9.0  # [s] of the drives; numbers of so short ones mean little, the page is what counts


@pytest.fixture(scope="module")
def results(module_patch):
    """All runs, short and few."""
    module_patch.setattr(control, "SETTLED", 5.0)
    module_patch.setattr(page, "SETTLED", 5.0)
    module_patch.setattr(ident, "SETTLED", 8.0)
    controlled = control.run_all(duration=LENGTH)
    surfaces = {
        (way, factor): control.surface(way, factor, np.array([0.5, 1.0, 1.5]), LENGTH)
        for way in control.WAYS
        for factor in (2.0, 1.0)
    }
    identified = {
        condition: ident.identify(condition, seeds=1, duration=LENGTH)
        for condition in ident.conditions()
    }
    qualities = {(2.0, 6.0): ident.quality(next(iter(identified.values())))}
    cases = [case for case in soils.SLIP_CASES if case.rate == 100.0]
    slip = soils.slip_runs(cases, seeds=2, duration=LENGTH)
    soil = soils.run_all(duration=LENGTH)
    by = dict.fromkeys(REGRESSIONS, qualities)
    starts = {kind: {2.0: qualities[2.0, 6.0]} for kind in by}
    return Results(
        controlled, surfaces, identified, by, by, starts, slip, soil, *page.further(soil["ideal"])
    )


@pytest.fixture(scope="module")
def module_patch():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


def test_the_page_is_written_and_all_its_links_resolve(results, tmp_path):
    pytest.importorskip("matplotlib", reason="figures need the extra `render`")
    files = PAGE.write(results, tmp_path)
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert len(links) == 11 and all("/" not in link for link in links)
    for link in links:
        assert 5_000 < (tmp_path / link).stat().st_size < 400_000
    assert {file.name for file in files} == {file.name for file in tmp_path.iterdir()}
    numbers = set()
    for first, last in re.findall(r"[Ff]igures? (\d+)(?: (?:to|and) (\d+))?", text):
        numbers |= set(range(int(first), int(last or first) + 1))
    assert set(range(9, 37)) <= numbers  # every figure of section 8 has its counterpart


def test_without_figures_the_page_links_to_nothing(results, tmp_path):
    PAGE.write(results, tmp_path, draw=False)
    assert not list(tmp_path.glob("*.png"))
    assert "](" not in (tmp_path / "page.md").read_text(encoding="utf-8")


def test_every_table_is_rectangular_and_free_of_bars(results):
    found = [claims_table(PAGE.claims(results))]
    found += [PAGE.table(key, results) for key in PAGE.tables]
    for rows in found:
        assert len(rows) > 1 and {len(row) for row in rows} == {len(rows[0])}
        assert not any("|" in cell or "\n" in cell for row in rows for cell in row)


def test_the_claims_cover_every_section_and_their_verdicts_are_known(results):
    found = PAGE.claims(results)
    places = " ".join(claim.place for claim in found)
    assert all(
        section in places
        for section in ("8.1", "8.2.1", "8.2.2", "8.2.3", "8.3.1", "8.3.2", "8.3.3")
    )
    assert {claim.agrees for claim in found} <= {"yes", "partly", "no", "only with the misprint",
                                                 "-"}  # fmt: skip
    assert all("nan" not in claim.ours for claim in found if claim.place.startswith("8.1"))


def test_the_row_with_bounds_is_not_called_the_paper_s(results):
    for key in ("identification", "by_path", "by_start"):
        cells = {cell for row in PAGE.table(key, results) for cell in row}
        assert {"printed", "bounded", "coupled"} <= cells and "paper" not in cells


def test_the_page_names_what_it_does_not_cover(results):
    assert "Not covered: " in PAGE.words["head"]


def test_a_verdict_is_yes_no_or_partly():
    assert verdict(True, True) == "yes"
    assert verdict(True, False) == "partly"
    assert verdict(False, False) == "no"


def test_the_terminal_s_table_fits(results):
    text = terminal(PAGE.claims(results), width=118)
    assert max(map(len, text.splitlines())) <= 118
    assert "agrees?" in text and "fig. 28" in text


def test_a_vehicle_that_stands_and_goes_on_is_found():
    time = np.arange(0.0, 10.0, 0.1)
    speed = np.where((time > 3.95) & (time < 6.95), 0.0, 1.0)
    assert page.standstill(time, speed) == pytest.approx((4.0, 7.0))
    assert np.isnan(page.standstill(time, np.ones_like(time))).all()


def test_a_time_that_never_comes_reads_never():
    assert page.seconds(float("nan")) == page.seconds(float("inf")) == "never"
