"""Section 8 of Strawa et al. (2021) as scenarios that can be run again.

    control         8.1, 8.2      controller with known and wrong parameters; figure 17
    identification  8.3.1         mass, inertia and resistance identified on line
    soil            8.3.2, 8.3.3  unscented Kalman filter for the slips; F_max and K
    control_figures               figures
Below: what the paper claims and what comes out. Every number is computed from the runs, and so is
every verdict; the words stand in page.toml. Vehicles are those of tracked_env; controller and
estimators are those of baselines.

References: [1] Strawa et al., Electronics 10 (2021) 187.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from reproduce import Cells, Outcome, PaperPage, Say, percent, verdict, words_of
from reproduce.policy_runs import Drive, Floats
from reproduce.strawa2021 import control, control_figures
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.control import PERIOD, SETTLED, SIDES, Case, Run, rms
from reproduce.strawa2021.identification import NAMES, REGRESSIONS, Condition, Quality

Rows = Iterable[Mapping[str, Any] | Cells]

STANDS = 0.05  # [m/s] slower than this a vehicle stands
STARTED = 0.5  # [s] the torques have left the bounds that they start in
EARLY = 10.0  # [s] the first stage of figure 16
METHODS = {method: line["label"] for method, line in control_figures.METHODS.items()}
METHODS["strawa"] = "this project's, paper's sensors"


class Results(NamedTuple):
    """All runs."""

    control: dict[Case, Run]
    sweep: dict[tuple[str, float], control.Surface]
    identification: dict[Condition, Drive]
    by_path: dict[str, dict[tuple[float, float], Quality]]  # by regression
    by_start: dict[str, dict[float, Quality]]
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
    by_start = {kind: ident.by_start(kind) for kind in REGRESSIONS}
    say("section 8.3.2: slip")
    slips = soils.slip_runs()
    say("section 8.3.3: soil")
    soil = soils.run_all()
    noise, windows = further(soil["ideal"])
    return Results(controlled, surfaces, identified, by_path, by_start, slips, soil, noise, windows)


def further(exact: soils.Soil) -> tuple[Any, Any]:
    """The printed method with noise of the slips, and over its window."""
    cases = {ground: case_of("manoeuvre", ground) for ground in soils.GROUNDS}
    noise = {
        ground: {sigma: soils.noisy(exact, case, sigma) for sigma in soils.NOISES}
        for ground, case in cases.items()
    }
    windows = {
        window: soils.noisy(exact, cases["changing"], soils.WINDOW_NOISE, window)
        for window in soils.WINDOWS
    }
    return noise, windows


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
    agrees = verdict(maps.settled_max > 0.1, beside < 0.2, line.settled_rms < maps.settled_rms)
    yield Outcome("maps", agrees, {"maps": maps, "line": line, "beside": beside})
    lost, fine = (runs["sandy-loam", "circle", factor] for factor in (2.0, 1.0))
    misprint = lost.settled_rms > 1.0 and fine.settled_rms < 0.01
    agrees = "only with the misprint" if misprint else verdict(lost.settled_rms > 1.0)
    yield Outcome("loam", agrees, {"lost": lost, "fine": fine})
    stop, again = standstill(lost.time, lost.truth["v_x"])
    agrees = verdict(math.isfinite(stop), 6.0 <= stop <= 7.0)
    yield Outcome("stop", agrees, {"stop": stop, "again": again})


def alike(run: Run, side: str) -> float:
    """Correlation of slip and torque of a track from STARTED on [-]."""
    late = run.time >= STARTED
    pair = run.truth[f"slip_{side}"][late], run.truth[f"torque_{side}"][late]
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
    numbers = {c: ident.quality(run) for c, run in runs.items() if c.kind != "fixed"}
    maps = Condition("printed", 2.0, "strawa")
    uniform = maps._replace(ground="uniform")
    noisy, plain, ideal = (numbers[c] for c in (maps, uniform, maps._replace(sensors="ideal")))

    def both(name: str, like: Condition) -> str:
        """A number for all regressions, with ideal and with the paper's sensors."""
        parts = []
        for kind in REGRESSIONS:
            pair = [like._replace(kind=kind, sensors=sensors) for sensors in ("ideal", "strawa")]
            values = " / ".join(percent(getattr(numbers[each], name)) for each in pair)
            parts.append(f"{NAMES[kind]} {values}")
        return "; ".join(parts)

    agrees = verdict(noisy.mass_straight_worst < 0.01, ideal.mass_straight_worst < 0.01)
    values: dict[str, Any] = {
        name: both(name, maps) for name in ("mass_straight", "mass_straight_worst")
    }
    yield Outcome("mass_straight", agrees, values)
    agrees = verdict(plain.mass_spiral_worst < 0.05, noisy.mass_spiral_worst < 0.05)
    values = {
        name: both("mass_spiral_worst", c) for name, c in (("uniform", uniform), ("maps", maps))
    }
    yield Outcome("mass_spiral", agrees, {**values, "exceeds": ideal.exceeds})

    on_maps = {kind: numbers[maps._replace(kind=kind)] for kind in REGRESSIONS}
    less = [
        q.inertia < q.mass_spiral
        for c, q in numbers.items()
        if c.kind == "printed" and c.ground == "uniform"
    ]
    rows = [{"name": NAMES[kind], "q": q} for kind, q in on_maps.items()]
    values = {"q": plain, "rows": rows, "settled": ident.SETTLED}
    yield Outcome("inertia", verdict(*less, noisy.inertia < noisy.mass_spiral), values)

    names = ("longitudinal_bias", "lateral_bias", "longitudinal_held", "lateral_held")
    means = {
        name: ", ".join(f"{NAMES[k]} {getattr(q, name):+.2g}" for k, q in on_maps.items())
        for name in names
    }
    small = [abs(getattr(noisy, name)) < 0.05 for name in names]
    yield Outcome("resistance", verdict(all(small[:2]), all(small[2:])), means)

    rmse = {c: rms(run.distance) for c, run in runs.items()}
    gain = min(rmse[c._replace(kind="fixed")] / rmse[c] for c in numbers)
    paths = {
        sensors: [rmse[maps._replace(kind=kind, sensors=sensors)] for kind in ident.KINDS]
        for sensors in ("ideal", "strawa")
    }
    yield Outcome("path", verdict(gain > 1.0), {**paths, "gain": gain})


def slip_claims(results: Results) -> Iterator[Outcome]:
    """Section 8.3.2."""
    slip = results.slip
    gentle = [i for i, c in enumerate(slip.cases) if c.speed == "gentle" and c.rate == 100.0]
    brisk = [c.speed == "brisk" and c.soil == "sandy loam" for c in slip.cases].index(True)
    rows: list[dict[str, Any]] = []
    for name in soils.MEASURED:
        calm = [soils.slip_quality(slip, i, name, side, False) for i in gentle for side in SIDES]
        rapid = [soils.slip_quality(slip, brisk, name, side, True) for side in SIDES]
        bias, sure = max(abs(q.bias) for q in calm), max(abs(q.bias) / q.uncertainty for q in calm)
        spread, peak = (max(q.rms for q in of) for of in (calm, rapid))
        rows.append({"name": name, "bias": bias, "sure": sure, "rms": spread, "peak": peak})
    unbiased = [row["sure"] < 3.0 and row["bias"] < 0.005 for row in rows]
    yield Outcome("unbiased", verdict(*unbiased), {"rows": rows, "seeds": slip.seeds})
    yield Outcome(
        "rapid", verdict(*(row["peak"] > 1.5 * row["rms"] for row in rows)), {"rows": rows}
    )


def soil_claims(results: Results) -> Iterator[Outcome]:
    """Section 8.3.3."""

    def qualities(way: str, ground: str) -> dict[str, soils.Quality]:
        case = case_of(way, ground)
        return {name: soils.quality(one, case) for name, one in results.soil.items()}

    ours, steady = qualities("manoeuvre", "changing"), qualities("circle", "changing")
    printed = ours["printed"]
    yield Outcome("accurate", verdict(printed.effort < 0.01, ours["strawa"].effort < 0.05), ours)
    yield Outcome("adapts", verdict(printed.adapted < 1.0), ours)
    yield Outcome("iterations", verdict(printed.error_failed > 3.0 * printed.error_converged), ours)

    windows = {n: soils.quality(one, 0) for n, one in results.soil_window.items()}
    shorter = [q.effort for n, q in windows.items() if n < soils.WINDOW]
    values = {"rows": [{"n": n, "q": q} for n, q in windows.items()], "noise": soils.WINDOW_NOISE}
    yield Outcome("window", verdict(windows[soils.WINDOW].effort < min(shorter)), values)

    rows = [{"name": n, "circle": steady[n], "manoeuvre": ours[n]} for n in ("rtk", "strawa")]
    agrees = verdict(*(steady[n].effort < ours[n].effort for n in ("rtk", "strawa")))
    yield Outcome("steady", agrees, {"rows": rows})

    firm = qualities("manoeuvre", "heavy clay")
    little = min(sigma for sigma in results.soil_noise["heavy clay"] if sigma > 0.0)
    disturbed = soils.quality(results.soil_noise["heavy clay"][little], 0)
    first, clay = int(soils.RECOVERY / PERIOD), case_of("manoeuvre", "heavy clay")
    slip = float(results.soil["ideal"].slip[first:, clay].max())
    yield Outcome("clay", "-", {**firm, "little": little, "disturbed": disturbed, "slip": slip})


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
    for (name, path, factor), run in results.control.items():
        truth, late = run.truth, run.time >= 1.0
        limited = np.zeros(late.sum(), dtype=bool)
        for side in SIDES:
            demand = np.abs(truth[f"action_{side}"] * truth["torque_limit"])
            torque = np.abs(truth[f"effort_{side}"] * truth["sprocket_radius"])
            limited |= (demand > torque + 1.0)[late]
        slip = max(float(np.abs(truth[f"slip_{side}"][late]).max()) for side in SIDES)
        words = {"case": control_figures.NAMES[name], "path": path, "factor": factor, "run": run}
        yield {**words, "limited": limited.mean(), "slip": slip}


def sweep_rows(results: Results) -> Rows:
    """Figure 17 in numbers."""
    for (way, factor), surface in results.sweep.items():
        yield {"way": way, "factor": factor, "errors": surface.along()}


def identification_rows(results: Results) -> Rows:
    """Section 8.3.1, one line per condition."""
    for c, run in results.identification.items():
        if c.kind == "fixed":
            head = [c.ground, c.lateral, c.sensors, f"{c.factor:g}", NAMES[c.kind]]
            yield [*head, *(["-"] * 9), f"{rms(run.distance):.2g}"]
        else:
            q = ident.quality(run)
            yield {"c": c, "name": NAMES[c.kind], "q": q, "exceeds": seconds(q.exceeds)}


def by_rows(results: Mapping[str, Mapping[Any, Quality]]) -> Rows:
    """Error of the mass by regression and another condition."""
    for kind, numbers in results.items():
        for by, q in numbers.items():
            yield {"name": NAMES[kind], "by": by, "q": q, "exceeds": seconds(q.exceeds)}


def slip_rows(results: Results) -> Rows:
    """Section 8.3.2, one line per case, measurement and track."""
    for i, case in enumerate(results.slip.cases):
        for name in soils.MEASURED:
            for side in SIDES:
                cells = [case.speed, case.soil, f"{case.rate:g}", name, side]
                for rapid in (False, True):
                    q = soils.slip_quality(results.slip, i, name, side, rapid)
                    bias = f"{100 * q.bias:+.2f} ± {100 * q.uncertainty:.2f} %"
                    cells += [] if rapid else [percent(q.true)]
                    cells += ["-", "-"] if math.isnan(q.rms) else [bias, percent(q.rms)]
                yield cells


def soil_values(soil: soils.Soil, number: int = 0, **values: Any) -> Mapping[str, Any]:
    """What every table of 8.3.3 says of one case."""
    q = soils.quality(soil, number)
    return {**values, "q": q, "adapted": seconds(q.adapted)}


def soil_rows(results: Results) -> Rows:
    """Section 8.3.3, one line per method and case."""
    for method, soil in results.soil.items():
        for i, case in enumerate(soils.CASES):
            yield soil_values(soil, i, method=METHODS[method], case=case)


def soil_noise_rows(results: Results) -> Rows:
    """The printed method over the noise of the slip."""
    for ground, by_noise in results.soil_noise.items():
        for sigma, soil in by_noise.items():
            yield soil_values(soil, ground=ground, sigma=sigma)


TABLES = {
    "control": control_rows,
    "sweep": sweep_rows,
    "identification": identification_rows,
    "by_path": lambda results: by_rows(results.by_path),
    "by_start": lambda results: by_rows(results.by_start),
    "slip": slip_rows,
    "soil": soil_rows,
    "soil_noise": soil_noise_rows,
    "soil_window": lambda results: (
        soil_values(soil, window=n) for n, soil in results.soil_window.items()
    ),
}
PAGE = PaperPage(
    "strawa2021", words_of(__file__), outcomes, TABLES, (control_figures.drawings,), vars(soils)
)
