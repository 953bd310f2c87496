"""The page of the paper: it is written, its links resolve, its verdicts follow the numbers."""

import re

import numpy as np
import pytest

from baselines.slip import slip_sweep
from reproduce.focchi2025 import (
    PAGE,
    Results,
    claims,
    control,
    identification,
    load_models,
    planning_loop,
    run_everything,
    slopes,
)
from reproduce.focchi2025.control import vehicle
from reproduce.paper_page import claims_table, terminal

pytestmark = pytest.mark.slow

LENGTH = 5.0  # [s] of the drives; numbers of so short ones mean little, the page is what counts
COARSE = 1.3  # [rad/s]


@pytest.fixture(scope="module")
def module_patch():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


def short_drive(cases, seeds=control.SEEDS, duration=LENGTH):
    """All cases at 50 Hz, whatever they ask for, but for decision trees, which take long."""
    asked = {
        case: case._replace(rate=50, kind="table" if case.kind == "trees" else case.kind)
        for case in cases
    }
    driven = drive(list(dict.fromkeys(asked.values())), 2, duration)
    return {case: driven[stands] for case, stands in asked.items()}


drive = control.drive


@pytest.fixture(scope="module")
def found(module_patch, tmp_path_factory):
    """All runs, short and few; the real vehicle is a simulated one."""
    runs = slip_sweep.sweep(vehicle(0.5, 0.2), COARSE)
    alpha = np.arctan2(runs.v_y - 0.04 * runs.yaw_rate, runs.v_x)
    file = tmp_path_factory.mktemp("real") / "real.csv"
    table = (34.45 * runs.sprocket_left, 34.45 * runs.sprocket_right, runs.beta_left,
             runs.beta_right, alpha)  # fmt: skip
    np.savetxt(file, np.stack(table, axis=1), delimiter=",")
    for module in (identification, control):
        module_patch.setattr(module, "sweep", coarse_sweep)
    module_patch.setattr(control, "DURATION", LENGTH)
    module_patch.setattr(control, "drive", short_drive)
    for module in (load_models, slopes):
        module_patch.setattr(module, "DURATION", 1.0)
    module_patch.setattr(slopes, "RATE", 50.0)
    module_patch.setattr(planning_loop, "GOALS", 6)
    module_patch.setattr(planning_loop, "SOME", 2)
    module_patch.setattr(slopes, "SPEED_STEP", 6.0)
    module_patch.setattr(slopes, "PROBES", 40)
    said = []
    made = run_everything(said.append, file, file.with_name("no-map.npz"))
    assert len(said) >= 4 and any("no-map.npz" in line for line in said)
    return made


def coarse_sweep(parameters, _step=None):
    return slip_sweep.sweep(parameters, COARSE)


def test_the_page_is_written_and_all_its_links_resolve(found, tmp_path):
    pytest.importorskip("matplotlib", reason="figures need the extra `render`")
    files = PAGE.write(found, tmp_path)
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert len(links) == 15 and all("/" not in link for link in links)
    for link in links:
        assert 5_000 < (tmp_path / link).stat().st_size < 500_000
    assert {file.name for file in files} == {file.name for file in tmp_path.iterdir()}
    numbers = set()
    for first, last in re.findall(r"[Ff]igures? (\d+)(?: (?:to|and) (\d+))?", text):
        numbers |= set(range(int(first), int(last or first) + 1))
    assert {6, 7, 8, 9, 10, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23} <= numbers


def test_without_figures_the_page_links_to_nothing(found, tmp_path):
    PAGE.write(found, tmp_path, draw=False)
    assert not list(tmp_path.glob("*.png"))
    assert "](" not in (tmp_path / "page.md").read_text(encoding="utf-8")


def test_every_table_is_rectangular_and_free_of_bars(found):
    tables = [claims_table(PAGE.claims(found))]
    tables += [PAGE.table(key, found) for key in PAGE.tables]
    for rows in tables:
        assert len(rows) > 1 and {len(row) for row in rows} == {len(rows[0])}
        assert not any("|" in cell or "\n" in cell for row in rows for cell in row)


def test_the_claims_cover_every_experiment_and_their_verdicts_are_known(found):
    made = PAGE.claims(found)
    places = " ".join(claim.place for claim in made)
    asked = ("fig. 8", "fig. 9", "fig. 10", "fig. 13", "fig. 14", "(54)", "figs 6, 7", "2.3",
             "fig. 16", "Table 4", "fig. 17", "fig. 18", "Table 5", "(29)",
             "(34)", "8.1, fig. 21", "8.2", "8.3, fig. 23")  # fmt: skip
    assert all(place in places for place in asked)
    verdicts = {claim.agrees for claim in made}
    assert verdicts <= {"yes", "partly", "no", "-"}
    assert not any("nan" in claim.ours for claim in made)


def test_the_page_names_what_it_does_not_cover():
    said = PAGE.words["head"].split("Not covered: ")[1]
    assert all(part in said for part in ("figure 15", "neural networks", "actual sprocket speeds"))


def test_an_offset_of_the_markers_is_called_a_hypothesis_and_no_confirmation(found):
    (claim,) = [c for c in PAGE.claims(found) if "only a qualitative match of alpha" in c.claim]
    assert "hypothesis" in claim.why and claim.agrees == "yes"
    each = found.identification.behind_each
    assert all(claims.cm(one) in claim.ours for one in each)
    # Slip of another size moves the two apart; their mean is the offset of the made-up vehicle.
    assert 0.5 * sum(each) == pytest.approx(0.04, abs=1e-3) and each[1] > each[0] + 0.02


def test_without_scikit_learn_or_a_real_vehicle_the_claims_say_so(found):
    bare = found.identification.simulated._replace(trees=None, held_out=None, unseen=None)
    reduced = found.identification._replace(
        simulated=bare, measured=None, against_measured={}, behind={}, missing="needs a package"
    )
    cut = found._replace(
        identification=reduced,
        chicane={case: run for case, run in found.chicane.items() if case.kind != "trees"},
    )
    made = PAGE.claims(cut)
    assert any(c.ours == "not computed" and c.why == "needs a package" for c in made)
    assert not any("fig. 9" in claim.place for claim in made)
    assert len(PAGE.markdown(cut)) > 5_000


def test_the_terminal_s_table_fits(found):
    text = terminal(PAGE.claims(found), width=118)
    assert max(map(len, text.splitlines())) <= 118
    assert "agrees?" in text and "fig. 13" in text


def test_the_results_are_complete(found):
    assert isinstance(found, Results)
    assert {case.kind for case in found.chicane} == {"uc", "table", *control.REGRESSED, "online"}
    assert all(len(slip[0]) == round(50 * LENGTH) for slip in found.predicted.values())
