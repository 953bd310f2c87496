"""The pages of both papers: written, links resolve, verdicts follow the numbers."""

import re
from functools import partial

import numpy as np
import pytest

import reproduce.focchi2025 as focchi
import reproduce.strawa2021 as strawa
from baselines.slip import slip_sweep
from reproduce import claims_table, label_all, panels, terminal, verdict
from reproduce.focchi2025 import control as chicane
from reproduce.focchi2025 import identification as sweeps
from reproduce.focchi2025 import load_models, planning_loop, slopes
from reproduce.strawa2021 import Results, control
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import soil as soils

pytestmark = pytest.mark.slow

LENGTH = 9.0  # [s] of the drives; numbers of so short ones mean little, the page is what counts
BRIEF = 3.0  # [s] of the drives of which there are most
SHORTER = 5.0  # [s] of the chicane
COARSE = 1.3  # [rad/s]
PAPERS = {"strawa2021": strawa, "focchi2025": focchi}
LINKS = {"strawa2021": 11, "focchi2025": 13}
FIGURES = {  # of the papers: each has its counterpart
    "strawa2021": set(range(9, 37)),
    "focchi2025": {6, 7, 8, 9, 10, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23},
}
PLACES = {
    "strawa2021": ("8.1", "8.2.1", "8.2.2", "8.2.3", "8.3.1", "fig. 28", "8.3.2", "8.3.3"),
    "focchi2025": (
        "fig. 8", "fig. 9", "fig. 10", "fig. 13", "fig. 14", "(54)", "figs 6, 7", "2.3", "fig. 16",
        "Table 4", "fig. 17", "fig. 18", "Table 5", "(29)", "(34)", "8.1, fig. 21", "8.2",
        "8.3, fig. 23",
    ),
}  # fmt: skip
UNCOVERED = {
    "strawa2021": ("electric circuit", "two accelerometers", "figure 16"),
    "focchi2025": ("figure 15", "neural networks", "actual sprocket speeds"),
}


@pytest.fixture(scope="module")
def module_patch():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def of_strawa(module_patch):
    """All runs, short and few."""
    for module, settled in ((control, 5.0), (strawa, 5.0), (ident, 2.0)):
        module_patch.setattr(module, "SETTLED", settled)
    controlled = control.run_all(duration=LENGTH)
    factors = np.array([0.5, 1.0, 1.5])
    surfaces = {
        (way, factor): control.surface(way, factor, factors, LENGTH)
        for way in control.WAYS
        for factor in control.TURNING_FACTORS
    }
    identified = {
        condition: ident.identify(condition, seeds=1, duration=BRIEF)
        for condition in ident.conditions()
    }
    quality = ident.quality(next(iter(identified.values())))
    by = {kind: {(2.0, 6.0): quality} for kind in ident.REGRESSIONS}
    starts = {kind: {2.0: quality} for kind in ident.REGRESSIONS}
    cases = [case for case in soils.SLIP_CASES if case.rate == 100.0]
    slip = soils.slip_runs(cases, seeds=2, duration=LENGTH)
    soil = soils.run_all(duration=LENGTH)
    further = strawa.further(soil["ideal"])
    return Results(controlled, surfaces, identified, by, starts, slip, soil, *further)


def short_drive(drive, cases, seeds=2, duration=SHORTER):
    """All cases at 50 Hz, whatever they ask for, but for decision trees, which take long."""
    stands = {
        case: case._replace(rate=50, kind="table" if case.kind == "trees" else case.kind)
        for case in cases
    }
    runs = drive(list(dict.fromkeys(stands.values())), seeds, duration)
    return {case: runs[other] for case, other in stands.items()}


@pytest.fixture(scope="module")
def of_focchi(module_patch, tmp_path_factory):
    """All runs, short and few; the real vehicle is a simulated one."""
    parameters = chicane.vehicle(0.5, 0.2)
    runs = slip_sweep.sweep(parameters, COARSE)
    alpha = np.arctan2(runs.v_y - 0.04 * runs.yaw_rate, runs.v_x)
    file = tmp_path_factory.mktemp("real") / "real.csv"
    table = (34.45 * runs.sprocket_left, 34.45 * runs.sprocket_right, runs.beta_left,
             runs.beta_right, alpha)  # fmt: skip
    np.savetxt(file, np.stack(table, axis=1), delimiter=",")
    sweep = slip_sweep.sweep
    for module in (sweeps, chicane):
        module_patch.setattr(module, "sweep", lambda parameters, _=None: sweep(parameters, COARSE))
    module_patch.setattr(chicane, "DURATION", SHORTER)
    module_patch.setattr(chicane, "drive", partial(short_drive, chicane.drive))
    for module in (load_models, slopes):
        module_patch.setattr(module, "DURATION", 1.0)
    for name, value in (("RATE", 50.0), ("SPEED_STEP", 6.0), ("PROBES", 40)):
        module_patch.setattr(slopes, name, value)
    for name, value in (("GOALS", 6), ("SOME", 2), ("RATE", 50.0)):
        module_patch.setattr(planning_loop, name, value)
    module_patch.setattr(chicane, "SPIRAL_RATE", 50.0)
    lines = []
    results = focchi.run_everything(lines.append, file, file.with_name("no-map.npz"))
    assert len(lines) >= 4 and any("no-map.npz" in line for line in lines)
    return results


@pytest.fixture(scope="module", params=PAPERS)
def paper(request):
    """Name, page and results of a paper."""
    name = request.param
    return name, PAPERS[name].PAGE, request.getfixturevalue(f"of_{name[:-4]}")


def test_the_page_is_written_and_all_its_links_resolve(paper, tmp_path):
    name, page, results = paper
    files = page.write(results, tmp_path)
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert len(links) == LINKS[name] and all("/" not in link for link in links)
    for link in links:
        assert 5_000 < (tmp_path / link).stat().st_size < 500_000
    assert {file.name for file in files} == {file.name for file in tmp_path.iterdir()}
    numbers = set()
    for first, last in re.findall(r"[Ff]igures? (\d+)(?: (?:to|and) (\d+))?", text):
        numbers |= set(range(int(first), int(last or first) + 1))
    assert numbers >= FIGURES[name]


def test_every_table_is_rectangular_and_free_of_bars(paper):
    _, page, results = paper
    claims = claims_table(page.claims(results))
    for rows in (claims, *(page.table(key, results) for key in page.tables)):
        assert len(rows) > 1 and {len(row) for row in rows} == {len(rows[0])}
        assert not any("|" in cell or "\n" in cell for row in rows for cell in row)


def test_the_claims_cover_every_experiment_and_their_verdicts_are_known(paper):
    name, page, results = paper
    claims = page.claims(results)
    places = " ".join(claim.place for claim in claims)
    assert all(place in places for place in PLACES[name])
    verdicts = {claim.agrees for claim in claims}
    assert verdicts <= {"yes", "partly", "no", "-", "only with the misprint"}
    sure = [c for c in claims if name == "focchi2025" or c.place.startswith("8.1")]
    assert not any("nan" in claim.ours for claim in sure)
    text = terminal(claims, width=118)
    assert max(map(len, text.splitlines())) <= 118
    assert "agrees?" in text and PLACES[name][5] in text


@pytest.mark.parametrize("name", PAPERS)
def test_the_page_names_what_it_does_not_cover(name):
    missing = " ".join(PAPERS[name].PAGE.words["head"].split("Not covered: ")[1].split())
    assert all(part in missing for part in UNCOVERED[name])


def test_the_row_with_bounds_is_not_called_the_paper_s(of_strawa):
    for key in ("identification", "by_path", "by_start"):
        cells = {cell for row in strawa.PAGE.table(key, of_strawa) for cell in row}
        assert {"printed", "bounded", "coupled"} <= cells and "paper" not in cells


def test_an_offset_of_the_markers_is_called_a_hypothesis_and_no_confirmation(of_focchi):
    claims = focchi.PAGE.claims(of_focchi)
    (claim,) = [c for c in claims if "only a qualitative match of alpha" in c.claim]
    assert "hypothesis" in claim.why and claim.agrees == "yes"
    each = of_focchi.identification.behind_each
    assert all(f"{100.0 * one:.1f} cm" in claim.ours for one in each)
    # Slip of another size moves the two apart; their mean is the offset of the made-up vehicle.
    assert 0.5 * sum(each) == pytest.approx(0.04, abs=1e-3) and each[1] > each[0] + 0.02


def test_without_a_real_vehicle_there_are_no_claims_of_it(of_focchi):
    reduced = of_focchi.identification._replace(measured=None, against_measured={}, behind={})
    reduced_results = of_focchi._replace(identification=reduced)
    claims = focchi.PAGE.claims(reduced_results)
    assert not any("fig. 9" in claim.place for claim in claims)
    assert len(focchi.PAGE.markdown(reduced_results)) > 5_000


def test_a_verdict_is_yes_no_or_partly():
    assert [verdict(True, True), verdict(True, False), verdict(False)] == ["yes", "partly", "no"]


def test_a_vehicle_that_stands_and_goes_on_is_timed():
    time = np.arange(0.0, 10.0, 0.1)
    speed = np.where((time > 3.95) & (time < 6.95), 0.0, 1.0)
    assert strawa.standstill(time, speed) == pytest.approx((4.0, 7.0))
    assert np.isnan(strawa.standstill(time, np.ones_like(time))).all()
    assert strawa.seconds(float("nan")) == strawa.seconds(float("inf")) == "never"


def test_every_axes_gets_all_its_labels_also_from_an_iterator():
    _, axes = panels(2.0, 1, 2)
    label_all(axes.flat, {"title": ("speed", "slip"), "ylabel": ("[m/s]", "[%]")})
    labels = [(panel.get_title(), panel.get_ylabel()) for panel in axes[0]]
    assert labels == [("speed", "[m/s]"), ("slip", "[%]")]
