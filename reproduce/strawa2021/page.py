"""What the paper claims in section 8 and what comes out: every number is computed from the runs,
and so is every verdict. The words stand in page.toml.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from reproduce.paper_page import Outcome, PaperPage, Rows, Say, percent, verdict, words_of
from reproduce.strawa2021 import control, control_figures
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.control import PERIOD, SCENARIOS, SETTLED, SIDES, Drive, Floats, Run, rms
from reproduce.strawa2021.identification import NAMES, REGRESSIONS, Condition

STANDS = 0.05  # [m/s] slower than this a vehicle stands
STARTED = 0.5  # [s] the torques have left the bounds that they start in
EARLY = 10.0  # [s] the first stage of figure 16
METHODS = {
    "printed": "printed method, true slips",
    "ideal": "this project's, true slips",
    "rtk": "this project's, rtk sensors",
    "strawa": "this project's, paper's sensors",
}


class Results(NamedTuple):
    """All runs."""

    control: dict[tuple[str, str, float], Run]
    sweep: dict[tuple[str, float], control.Surface]
    identification: dict[Condition, Drive]
    by_path: dict[str, dict[tuple[float, float], ident.Quality]]  # by regression
    by_noise: dict[str, dict[tuple[float, float], ident.Quality]]
    by_start: dict[str, dict[float, ident.Quality]]
    slip: soils.Slips
    soil: dict[str, soils.Soil]
    soil_noise: dict[str, dict[float, soils.Soil]]  # by ground and sigma of the slips
    soil_window: dict[int, soils.Soil]  # by window [control steps]


def run_everything(say: Say = lambda text: None) -> Results:
    """Run all scenarios; say(text) reports which ones come next."""
    say("sections 8.1, 8.2: controller")
    controlled = control.run_all()
    say("figure 17: mass and inertia")
    surfaces = control.sweep_all()
    say("section 8.3.1: mass, inertia, resistance")
    identified = ident.run_all()
    by_path = {kind: ident.by_path(kind) for kind in REGRESSIONS}
    by_noise = {kind: ident.by_noise(kind) for kind in REGRESSIONS}
    by_start = {kind: ident.by_start(kind) for kind in REGRESSIONS}
    say("section 8.3.2: slip")
    slips = soils.slip_runs()
    say("section 8.3.3: soil")
    soil = soils.run_all()
    noise = {
        ground: soils.with_noise(soil["ideal"], case_of("manoeuvre", ground))
        for ground in soils.GROUNDS
    }
    windows = soils.by_window(soil["ideal"], case_of("manoeuvre", "changing"))
    return Results(
        controlled, surfaces, identified, by_path, by_noise, by_start, slips, soil, noise, windows
    )


def case_of(way: str, ground: str) -> int:
    """Number of a case of section 8.3.3."""
    return soils.CASES.index(soils.Case(way, ground))


# Claims


def controller_claims(results: Results) -> Iterator[Outcome]:
    """Sections 8.1 and 8.2."""
    runs = results.control
    exact = [run for (name, _, _), run in runs.items() if name == "exact"]
    left, late = max(run.settled_max for run in exact), exact[0].time >= SETTLED
    states = ("v_x", "yaw_rate", "slip_left", "slip_right")
    moving = max(float(np.ptp(run.truth[name][late])) for run in exact for name in states)
    agrees = verdict(left < 1e-5 and moving < 1e-5)
    yield Outcome("exact", agrees, {"left": left, "settled": SETTLED, "moving": moving})

    right = runs["exact", "circle", 2.0]
    belt_left, belt_right = (right.truth[f"sprocket_speed_{side}"][-1] for side in SIDES)
    apart = float(belt_right - belt_left)
    yield Outcome("apart", verdict(0.7 < apart < 1.4), {"apart": apart})
    like = min(alike(run, side) for run in exact for side in SIDES)
    yield Outcome("shape", verdict(like > 0.99), {"like": like, "started": STARTED})

    wrong = {
        f"{path}_{factor:.0f}": runs["mass-inertia", path, factor].settled_rms
        for path in control.PATHS
        for factor in (2.0, 1.0)
    }
    yield Outcome("wrong", verdict(all(0.1 < value < 3.0 for value in wrong.values())), wrong)
    other = runs["mass-inertia", "circle", 2.0]
    belts, torques = (apart_from(right, other, name) for name in ("sprocket_speed", "torque"))
    largest = max(float(np.abs(right.truth[f"torque_{side}"]).max()) for side in SIDES)
    agrees = verdict(belts[1] < 0.1 * belts[0], torques[0] < 0.1 * largest)
    yield Outcome("stage", agrees, {"belts": belts, "torques": torques, "settled": SETTLED})
    across = [surface.along() for surface in results.sweep.values()]
    masses, inertias = zip(*across, strict=True)
    ratio = min(mass / inertia for mass, inertia in across)
    values = {"mass": max(masses), "inertia": max(inertias), "ratio": ratio}
    yield Outcome("sweep", verdict(ratio > 1.0), values)

    maps, line = (runs["resistance-maps", path, 2.0] for path in control.PATHS)
    beside = float(np.abs(line.truth["y"][line.time >= SETTLED]).max())
    agrees = verdict(maps.settled_max > 0.1, beside < 0.2)
    yield Outcome("maps", agrees, {"maps": maps, "line": line, "beside": beside})
    lost, fine = (runs["sandy-loam", "circle", factor] for factor in (2.0, 1.0))
    misprint = lost.settled_rms > 1.0 and fine.settled_rms < 0.01
    agrees = "only with the misprint" if misprint else verdict(lost.settled_rms > 1.0)
    yield Outcome("loam", agrees, {"lost": lost, "fine": fine})
    stop, again = standstill(lost.time, lost.truth["v_x"])
    yield Outcome("stop", verdict(stop < 15.0), {"stop": stop, "again": again})


def alike(run: Run, side: str) -> float:
    """Correlation of slip and torque of a track from STARTED on [-]."""
    moved = run.time >= STARTED
    pair = run.truth[f"slip_{side}"][moved], run.truth[f"torque_{side}"][moved]
    return float(np.corrcoef(*pair)[0, 1])


def apart_from(right: Run, wrong: Run, name: str) -> tuple[float, float]:
    """Largest difference of a quantity of both tracks: before EARLY, and after SETTLED."""
    names = [f"{name}_{side}" for side in SIDES]
    apart = np.maximum(*(np.abs(wrong.truth[each] - right.truth[each]) for each in names))
    return float(apart[right.time < EARLY].max()), float(apart[right.time >= SETTLED].max())


def standstill(time: Floats, speed: Floats) -> tuple[float, float]:
    """First time [s] after 2 s at which the vehicle stands, and when it moves again; or nan."""
    stands = (np.abs(speed) < STANDS) & (time > 2.0)
    if not stands.any():
        return math.nan, math.nan
    first = int(stands.argmax())
    moves = (~stands[first:]).argmax()
    return float(time[first]), float(time[first + moves]) if moves else math.nan


def identification_claims(results: Results) -> Iterator[Outcome]:
    """Section 8.3.1."""
    runs = results.identification
    found = {c: ident.quality(run) for c, run in runs.items() if c.kind != "fixed"}
    maps = Condition("printed", 2.0, "strawa")
    uniform = maps._replace(ground="uniform")
    noisy, plain, ideal = found[maps], found[uniform], found[maps._replace(sensors="ideal")]

    def both(name: str, like: Condition) -> str:
        """A number for all regressions, with ideal and with the paper's sensors."""
        parts = []
        for kind in REGRESSIONS:
            pair = [like._replace(kind=kind, sensors=sensors) for sensors in ("ideal", "strawa")]
            values = " / ".join(percent(getattr(found[each], name)) for each in pair)
            parts.append(f"{NAMES[kind]} {values}")
        return "; ".join(parts)

    agrees = verdict(noisy.mass_straight_worst < 0.01, ideal.mass_straight_worst < 0.01)
    values = {"rms": both("mass_straight", maps), "worst": both("mass_straight_worst", maps)}
    yield Outcome("mass_straight", agrees, values)
    agrees = verdict(plain.mass_spiral_worst < 0.05, noisy.mass_spiral_worst < 0.05)
    values = {
        name: both("mass_spiral_worst", c) for name, c in (("uniform", uniform), ("maps", maps))
    }
    yield Outcome("mass_spiral", agrees, {**values, "exceeds": ideal.exceeds})

    on_maps = {kind: found[maps._replace(kind=kind)] for kind in REGRESSIONS}
    less = [
        q.inertia < q.mass_spiral
        for c, q in found.items()
        if c.kind == "printed" and c.ground == "uniform"
    ]
    pairs = [
        f"{NAMES[kind]} {percent(q.inertia)}, {percent(q.mass_spiral)}"
        for kind, q in on_maps.items()
    ]
    numbers: dict[str, Any] = {
        "inertia": percent(plain.inertia),
        "mass": percent(plain.mass_spiral),
        "maps": "; ".join(pairs),
        "settled": ident.SETTLED,
    }
    yield Outcome("inertia", verdict(*less, noisy.inertia < noisy.mass_spiral), numbers)

    names = ("longitudinal_bias", "lateral_bias", "longitudinal_held", "lateral_held")
    means = {
        name: ", ".join(f"{NAMES[k]} {getattr(q, name):+.2g}" for k, q in on_maps.items())
        for name in names
    }
    small = [abs(getattr(noisy, name)) < 0.05 for name in names]
    yield Outcome("resistance", verdict(all(small[:2]), all(small[2:])), means)

    rmse = {c: rms(run.error) for c, run in runs.items()}
    gain = min(rmse[c._replace(kind="fixed")] / rmse[c] for c in found)
    paths = {
        sensors: " / ".join(
            f"{rmse[maps._replace(kind=kind, sensors=sensors)]:.2g}" for kind in ident.KINDS
        )
        for sensors in ("ideal", "strawa")
    }
    yield Outcome("path", verdict(gain > 1.0), {**paths, "gain": gain})


def slip_claims(results: Results) -> Iterator[Outcome]:
    """Section 8.3.2."""
    slip = results.slip
    gentle = [i for i, c in enumerate(slip.cases) if c.speed == "gentle" and c.rate == 100.0]
    brisk = [c.speed == "brisk" and c.soil == "sandy loam" for c in slip.cases].index(True)
    calm_texts, rapid_texts, unbiased, leaves = [], [], [], []
    for name in soils.MEASURED:
        calm = [soils.slip_quality(slip, i, name, side, False) for i in gentle for side in SIDES]
        rapid = [soils.slip_quality(slip, brisk, name, side, True) for side in SIDES]
        bias, sure = max(abs(q.bias) for q in calm), max(abs(q.bias) / q.uncertainty for q in calm)
        spread, peak = (max(q.rms for q in of) for of in (calm, rapid))
        calm_texts.append(
            f"z = {name}: bias at most {percent(bias)} ({sure:.1f} standard errors), rms "
            f"{percent(spread)}"
        )
        rapid_texts.append(f"z = {name}: rms {percent(peak)}")
        unbiased.append(sure < 3.0 and bias < 0.005)
        leaves.append(peak > 1.5 * spread)
    values = {"calm": "; ".join(calm_texts), "seeds": slip.seeds}
    yield Outcome("unbiased", verdict(*unbiased), values)
    yield Outcome("rapid", verdict(*leaves), {"rapid": "; ".join(rapid_texts)})


def soil_claims(results: Results) -> Iterator[Outcome]:
    """Section 8.3.3."""

    def qualities(way: str, ground: str) -> dict[str, soils.Quality]:
        case = case_of(way, ground)
        return {name: soils.quality(found, case) for name, found in results.soil.items()}

    ours, steady = qualities("manoeuvre", "changing"), qualities("circle", "changing")
    printed = ours["printed"]
    texts = {
        name: f"{percent(ours[name].effort)} and {percent(ours[name].modulus)}"
        for name in ("printed", "rtk", "strawa")
    }
    agrees = verdict(printed.effort < 0.01, ours["strawa"].effort < 0.05)
    yield Outcome("accurate", agrees, texts)
    yield Outcome("adapts", verdict(printed.adapted < 1.0), {"adapted": printed.adapted})
    values = {
        "without": percent(printed.error_failed),
        "failed": percent(printed.failed),
        "converged": percent(printed.error_converged),
        "iterations": printed.iterations,
    }
    agrees = verdict(printed.error_failed > 3.0 * printed.error_converged)
    yield Outcome("iterations", agrees, values)

    windows = {n: soils.quality(found, 0) for n, found in results.soil_window.items()}
    shorter = [q.effort for n, q in windows.items() if n < soils.WINDOW]
    text = "; ".join(
        f"{n}: {percent(q.failed)} without convergence, F_max {percent(q.effort)}"
        for n, q in windows.items()
    )
    agrees = verdict(windows[soils.WINDOW].effort < min(shorter))
    yield Outcome("window", agrees, {"windows": text, "noise": soils.WINDOW_NOISE})

    text = "; ".join(
        f"{name}: F_max {percent(steady[name].effort)} on the circle, {percent(ours[name].effort)} "
        "on the manoeuvre"
        for name in ("rtk", "strawa")
    )
    agrees = verdict(*(steady[name].effort < ours[name].effort for name in ("rtk", "strawa")))
    yield Outcome("steady", agrees, {"steady": text})

    firm = qualities("manoeuvre", "heavy clay")
    little = min(sigma for sigma in results.soil_noise["heavy clay"] if sigma > 0.0)
    disturbed = soils.quality(results.soil_noise["heavy clay"][little], 0)
    begun, clay = int(soils.RECOVERY / PERIOD), case_of("manoeuvre", "heavy clay")
    values = {
        "effort": percent(firm["printed"].effort),
        "little": little,
        "disturbed": percent(disturbed.effort),
        "stiffness": percent(disturbed.stiffness),
        "ratio_only": percent(firm["ideal"].ratio_only),
        "slip": percent(float(results.soil["ideal"].slip[begun:, clay].max())),
    }
    yield Outcome("clay", "-", values)


def outcomes(results: Results) -> Iterator[Outcome]:
    """All, in the order of the paper."""
    for part in (controller_claims, identification_claims, slip_claims, soil_claims):
        yield from part(results)


# Tables


def seconds(value: float) -> str:
    """A time; "never" when there is none."""
    return f"{value:.1f} s" if math.isfinite(value) else "never"


def control_rows(results: Results) -> Rows:
    """Errors after SETTLED, saturation, top slip."""
    rows = []
    for (name, path, factor), run in results.control.items():
        truth, late = run.truth, run.time >= 1.0
        limited = np.zeros(late.sum(), dtype=bool)
        for row, side in enumerate(SIDES):
            demand = np.abs(run.sprocket_torque[row])
            torque = np.abs(truth[f"effort_{side}"] * truth["sprocket_radius"])
            limited |= (demand > torque + 1.0)[late]
        slip = max(float(np.abs(truth[f"slip_{side}"][late]).max()) for side in SIDES)
        errors = [f"{run.settled_rms:.2g}", f"{run.settled_max:.2g}"]
        shares = [f"{100.0 * limited.mean():.0f} %", f"{100.0 * slip:.1f} %"]
        case = SCENARIOS[name]
        rows.append([case.section, case.title, path, f"{factor:g}", *errors, *shares])
    return rows


def sweep_rows(results: Results) -> Rows:
    """Figure 17 in numbers."""
    return [
        [way, f"{factor:g}", *(f"{error:.2g}" for error in surface.along())]
        for (way, factor), surface in results.sweep.items()
    ]


def identification_rows(results: Results) -> Rows:
    """Section 8.3.1, one line per condition."""
    rows = []
    for c, run in results.identification.items():
        head = [c.ground, c.lateral, c.sensors, f"{c.factor:g}", NAMES[c.kind]]
        if c.kind == "fixed":
            rows.append([*head, *(["-"] * 9), f"{rms(run.error):.2g}"])
            continue
        q = ident.quality(run)
        mass = [
            percent(q.mass_straight_worst),
            percent(q.mass_spiral),
            percent(q.mass_spiral_worst),
        ]
        along = [f"{q.longitudinal_bias:+.2g}", f"{q.longitudinal_rms:.2g}"]
        across = [f"{q.lateral_bias:+.2g}", f"{q.lateral_rms:.2g}", f"{q.rmse:.2g}"]
        rows.append([*head, *mass, seconds(q.exceeds), percent(q.inertia), *along, *across])
    return rows


def by_path_rows(results: Results) -> Rows:
    """Mass error over speed and final radius."""
    return [
        [NAMES[kind], f"{speed:g}", f"{radius:g}", percent(q.mass_straight_worst),
         percent(q.mass_spiral), seconds(q.exceeds), percent(q.inertia)]
        for kind, found in results.by_path.items()
        for (speed, radius), q in found.items()
    ]  # fmt: skip


def by_noise_rows(results: Results) -> Rows:
    """Mass error over noise and excitation."""
    return [
        [NAMES[kind], f"{noise:g}", f"{amplitude:g}", percent(q.mass_straight_worst),
         percent(q.mass_spiral_worst), percent(q.inertia)]
        for kind, found in results.by_noise.items()
        for (noise, amplitude), q in found.items()
    ]  # fmt: skip


def by_start_rows(results: Results) -> Rows:
    """Mass error over the speed at the start."""
    return [
        [NAMES[kind], f"{start:g}", percent(q.mass_straight_worst), percent(q.mass_straight),
         percent(q.mass_spiral_worst)]
        for kind, found in results.by_start.items()
        for start, q in found.items()
    ]  # fmt: skip


def slip_rows(results: Results) -> Rows:
    """Section 8.3.2, one line per case, measurement and track."""
    rows = []
    for i, case in enumerate(results.slip.cases):
        for name in soils.MEASURED:
            for side in SIDES:
                cells = [case.speed, case.soil, f"{case.rate:g}", name, side]
                for rapid in (False, True):
                    q = soils.slip_quality(results.slip, i, name, side, rapid)
                    if not rapid:
                        cells.append(percent(q.true))
                    bias = f"{100 * q.bias:+.2f} ± {100 * q.uncertainty:.2f} %"
                    cells += ["-", "-"] if math.isnan(q.rms) else [bias, percent(q.rms)]
                rows.append(cells)
    return rows


def soil_cells(q: soils.Quality) -> list[str]:
    """What every table of 8.3.3 says of one case."""
    errors = [percent(value) for value in (q.effort, q.modulus, q.stiffness)]
    return [*errors, seconds(q.adapted), f"{q.iterations:.1f}", percent(q.failed)]


def soil_rows(results: Results) -> Rows:
    """Section 8.3.3, one line per method and case."""
    rows = []
    for method, found in results.soil.items():
        for i, case in enumerate(soils.CASES):
            q = soils.quality(found, i)
            cells = [METHODS[method], case.way, case.ground, *soil_cells(q)]
            rows.append([*cells, percent(q.ratio_only)])
    return rows


def soil_noise_rows(results: Results) -> Rows:
    """The printed method over the noise of the slip."""
    return [
        [ground, f"{sigma:g}", *soil_cells(soils.quality(one, 0))]
        for ground, found in results.soil_noise.items()
        for sigma, one in found.items()
    ]


def soil_window_rows(results: Results) -> Rows:
    """The printed method over its window."""
    return [
        [f"{window}", *soil_cells(soils.quality(one, 0))]
        for window, one in results.soil_window.items()
    ]


TABLES = {
    "control": control_rows, "sweep": sweep_rows, "identification": identification_rows,
    "by_path": by_path_rows, "by_noise": by_noise_rows, "by_start": by_start_rows,
    "slip": slip_rows, "soil": soil_rows, "soil_noise": soil_noise_rows,
    "soil_window": soil_window_rows,
}  # fmt: skip
PAGE = PaperPage(
    "strawa2021", words_of(__file__), outcomes, TABLES, (control_figures.drawings,), vars(soils)
)
