"""What the paper claims in section 8, what comes out here, and whether the two agree.

Every number is computed from the runs; so is every verdict.
"""

import math

import numpy as np
from numpy.typing import NDArray

from reproduce.paper_page import Claim, percent, verdict
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import slip as slips
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.control import PERIOD, SETTLED, Run, rms
from reproduce.strawa2021.identification import Condition
from reproduce.strawa2021.results import REGRESSIONS, Results
from reproduce.strawa2021.soil import WINDOW

STANDS = 0.05  # [m/s] slower than this a vehicle stands
STARTED = 0.5  # [s] the torques have left the bounds that they start in
EARLY = 10.0  # [s] the first stage of figure 16


def controller_claims(results: Results) -> list[Claim]:
    """Sections 8.1 and 8.2."""
    runs = results.control

    def of(name: str, path: str, factor: float) -> float:
        return runs[name, path, factor].settled_rms

    exact = [run for (name, _, _), run in runs.items() if name == "exact"]
    left = max(run.settled_max for run in exact)
    late = exact[0].time >= SETTLED
    moving = max(
        float(np.ptp(run.truth[name][late]))
        for run in exact
        for name in ("v_x", "yaw_rate", "slip_left", "slip_right")
    )
    circle = runs["exact", "circle", 2.0].truth
    apart = float(circle["sprocket_speed_right"][-1] - circle["sprocket_speed_left"][-1])
    wrong = {(p, f): of("mass-inertia", p, f) for p in ("circle", "straight") for f in (2.0, 1.0)}
    across = [s.along() for s in results.sweep.values()]
    ratio = min(mass / inertia for mass, inertia in across)
    maps = runs["resistance-maps", "circle", 2.0]
    line = runs["resistance-maps", "straight", 2.0]
    beside = float(np.abs(line.truth["y"][line.time >= SETTLED]).max())
    lost, fine = (runs["sandy-loam", "circle", factor] for factor in (2.0, 1.0))
    stop, again = standstill(lost.time, lost.truth["v_x"])
    misprint = lost.settled_rms > 1.0 and fine.settled_rms < 0.01
    like = min(alike(run, side) for run in exact for side in ("left", "right"))
    belts = apart_from(
        runs["exact", "circle", 2.0], runs["mass-inertia", "circle", 2.0], "sprocket_speed"
    )
    torques = apart_from(
        runs["exact", "circle", 2.0], runs["mass-inertia", "circle", 2.0], "torque"
    )
    largest = max(float(np.abs(circle[f"torque_{side}"]).max()) for side in ("left", "right"))
    return [
        Claim("8.1, figs 9-11", "with all parameters known no error remains",
              f"at most {left:.1g} m after {SETTLED:g} s, states constant to {moving:.1g}",
              verdict(left < 1e-5 and moving < 1e-5),
              "both factors in (20); the rest is float32 rounding of the observations"),
        Claim("8.1, fig. 12", "sprockets differ by about 1 rad/s on the circle",
              f"{apart:.2f} rad/s", verdict(0.7 < apart < 1.4),
              "v B / (R r) and slip; R = 10 m and 2 m/s are chosen, the paper names neither"),
        Claim("8.1, fig. 12", "the slip of a track has the shape of its torque",
              f"correlation at least {like:.4f}", verdict(like > 0.99),
              f"from {STARTED:g} s on; at slips this small S (7) is a straight line, F = F_max i l "
              "/ (2 K)"),
        Claim("8.2.1, figs 13-16", "55 % of the mass, 110 % of the inertia: inaccurate, acceptable",
              f"circle {wrong['circle', 2.0]:.2g} / {wrong['circle', 1.0]:.2g} m, straight "
              f"{wrong['straight', 2.0]:.2g} / {wrong['straight', 1.0]:.2g} m (factor 2 / 1)",
              verdict(all(0.1 < value < 3.0 for value in wrong.values())),
              "a constant lag along the path; \"acceptable\" is the paper's word"),
        Claim("8.2.1, fig. 16", "torque, sprocket speed and slip as with the right parameters, but "
              "for the sprocket speed in the first 10 s",
              f"circle: sprocket speeds differ by up to {belts[0]:.2g} rad/s before 10 s, "
              f"{belts[1]:.2g} rad/s after {SETTLED:g} s; torques by {torques[0]:.2g} and "
              f"{torques[1]:.2g} N m",
              verdict(belts[1] < 0.1 * belts[0], torques[0] < 0.1 * largest),
              "factor 2; the torques differ at the start as well, where the vehicle is far from "
              "its path"),
        Claim("8.2.1, fig. 17", "a wrong mass costs more than a wrong inertia",
              f"wrong by up to half: mass {max(m for m, _ in across):.2g} m, inertia "
              f"{max(i for _, i in across):.1g} m", verdict(ratio > 1.0),
              f"mass at least {ratio:.0f} times, on circle, straight line and manoeuvre"),
        Claim("8.2.2, figs 20-23", "on the maps (44), (45) the circle suffers, never steady; the "
              "straight line is good enough",
              f"circle {maps.settled_rms:.2g} m rms, {maps.settled_max:.2g} m at most; straight "
              f"{line.settled_rms:.2g} m behind, {beside:.2g} m beside",
              verdict(maps.settled_max > 0.1, beside < 0.2),
              "on the line the path is kept and the time is not"),
        Claim("8.2.3, figs 24-27", "on sandy loam the vehicle cannot follow its circle",
              f"factor 2: {lost.settled_rms:.2g} m rms; factor 1: {fine.settled_rms:.1g} m",
              "only with the misprint" if misprint else verdict(lost.settled_rms > 1.0),
              "the integral of the friction is half of (20), and that the soil carries here; the "
              "paper names neither radius nor speed"),
        Claim("8.2.3, figs 25, 27", "it practically stops in the 7th second, accelerates again a "
              "couple of seconds later",
              f"factor 2: stands from {stop:.1f} s to {again:.1f} s", verdict(stop < 15.0),
              "the time of the stop depends on start, radius and speed"),
    ]  # fmt: skip


def alike(run: Run, side: str) -> float:
    """Correlation of slip and torque of a track from STARTED on [-]."""
    moved = run.time >= STARTED
    pair = run.truth[f"slip_{side}"][moved], run.truth[f"torque_{side}"][moved]
    return float(np.corrcoef(*pair)[0, 1])


def apart_from(right: Run, wrong: Run, name: str) -> tuple[float, float]:
    """Largest difference of a quantity of both tracks: before EARLY, and after SETTLED."""
    apart = np.maximum(
        *(
            np.abs(wrong.truth[f"{name}_{side}"] - right.truth[f"{name}_{side}"])
            for side in ("left", "right")
        )
    )
    return float(apart[right.time < EARLY].max()), float(apart[right.time >= SETTLED].max())


def standstill(time: NDArray[np.float64], speed: NDArray[np.float64]) -> tuple[float, float]:
    """First time [s] after 2 s at which the vehicle stands, and when it moves again; or nan."""
    stands = (np.abs(speed) < STANDS) & (time > 2.0)
    if not stands.any():
        return math.nan, math.nan
    first = int(stands.argmax())
    moves = (~stands[first:]).argmax()
    return float(time[first]), float(time[first + moves]) if moves else math.nan


def _both(found: dict[Condition, ident.Quality], field: str, like: Condition) -> str:
    """A number for all regressions and both sensors, as text."""
    parts = []
    for kind in REGRESSIONS:
        values = [
            getattr(found[like._replace(kind=kind, sensors=sensors)], field)
            for sensors in ("ideal", "strawa")
        ]
        parts.append(f"{ident.NAMES[kind]} {percent(values[0])} / {percent(values[1])}")
    return "; ".join(parts)


def identification_claims(results: Results) -> list[Claim]:
    """Section 8.3.1."""
    found = {
        c: ident.quality(run) for c, run in results.identification.items() if c.kind != "fixed"
    }
    maps = Condition("printed", 2.0, "strawa")
    uniform = maps._replace(ground="uniform")
    rmse = {c: rms(run.error) for c, run in results.identification.items()}
    gains = [
        rmse[c._replace(kind="fixed")] / value for c, value in rmse.items() if c.kind != "fixed"
    ]
    noisy, plain = found[maps], found[uniform]
    ideal = found[maps._replace(sensors="ideal")]
    less = [q.inertia < q.mass_spiral for c, q in found.items() if c.kind == "printed"
            and c.ground == "uniform"]  # fmt: skip
    on_maps = {kind: found[maps._replace(kind=kind)] for kind in REGRESSIONS}

    def means(field: str) -> str:
        return ", ".join(f"{ident.NAMES[k]} {getattr(q, field):+.2g}" for k, q in on_maps.items())

    def path(sensors: str) -> str:
        return " / ".join(
            f"{rmse[maps._replace(kind=kind, sensors=sensors)]:.2g}" for kind in ident.KINDS
        )

    return [
        Claim("8.3.1, fig. 28", "mass error below 1 % on the straight line (7 s)",
              f"ideal / paper's noise, rms: {_both(found, 'mass_straight', maps)}; worst: "
              f"{_both(found, 'mass_straight_worst', maps)}",
              verdict(noisy.mass_straight_worst < 0.01, ideal.mass_straight_worst < 0.01),
              "only along the Y axis, where the maps are constant; S does not say whether noise "
              "was on; start at speed, see the table"),
        Claim("8.3.1, fig. 28", "mass error below 5 % in the spiral",
              f"worst on uniform ground: {_both(found, 'mass_spiral_worst', uniform)}; on the "
              f"maps: {_both(found, 'mass_spiral_worst', maps)}; printed leaves 5 % at "
              f"{ideal.exceeds:.1f} s (ideal)",
              verdict(plain.mass_spiral_worst < 0.05, noisy.mass_spiral_worst < 0.05),
              "with one forgetting factor a slope of mu_l passes for mass; how soon depends on "
              "speed and radius, see the table. The largest error of bounded is its own bound, "
              "five times the mass believed at first"),
        Claim("8.3.1, fig. 29", "inertia more accurate than mass",
              f"rms, noise, inertia and mass: printed on uniform ground {percent(plain.inertia)}, "
              f"{percent(plain.mass_spiral)}; on the maps "
              + "; ".join(f"{ident.NAMES[k]} {percent(q.inertia)}, {percent(q.mass_spiral)}"
                          for k, q in on_maps.items()),
              verdict(*less, noisy.inertia < noisy.mass_spiral),
              f"inertia from {ident.SETTLED:g} s on, when the yaw equation has been excited"),
        Claim("8.3.1, figs 30, 31", "mu_l, mu_t: good time average, late on fast changes",
              f"mean error of mu_l after 7 s: {means('longitudinal_bias')}, of mu_t: "
              f"{means('lateral_bias')}; while the mass is within 5 %: {means('longitudinal_held')}"
              f" and {means('lateral_held')}",
              verdict(abs(noisy.longitudinal_bias) < 0.05 and abs(noisy.lateral_bias) < 0.05,
                      abs(noisy.longitudinal_held) < 0.05 and abs(noisy.lateral_held) < 0.05),
              "maps, paper's noise; the mean goes with the mass: what is too much in m is missing "
              "in mu"),
        Claim("8.3.1, fig. 32", "identified parameters bring it closer to the path than wrong ones",
              f"RMSE wrong / printed / bounded / coupled: {path('ideal')} m ideal, "
              f"{path('strawa')} m noise",
              verdict(min(gains) > 1.0),
              f"at least {min(gains):.0f} times, both factors, both lateral models; also "
              "where the mass is lost: the error is the missing force over the believed mass, and "
              "that is large"),
    ]  # fmt: skip


def slip_claims(results: Results) -> list[Claim]:
    """Section 8.3.2."""
    slip = results.slip
    gentle = [i for i, c in enumerate(slip.cases) if c.speed == "gentle" and c.rate == 100.0]
    brisk = next(
        i for i, c in enumerate(slip.cases) if c.speed == "brisk" and c.soil == "sandy loam"
    )
    calm, rapid = {}, {}
    for name in slips.MEASURED:
        calm[name] = [slips.quality(slip, i, name, side, False)
                      for i in gentle for side in slips.SIDES]  # fmt: skip
        rapid[name] = [slips.quality(slip, brisk, name, side, True) for side in slips.SIDES]
    bias = {name: max(abs(q.bias) for q in found) for name, found in calm.items()}
    sure = {name: max(abs(q.bias) / q.uncertainty for q in found) for name, found in calm.items()}
    spread = {name: max(q.rms for q in found) for name, found in calm.items()}
    peak = {name: max(q.rms for q in found) for name, found in rapid.items()}
    return [
        Claim("8.3.2, fig. 33", "the UKF estimates both slips without bias in slow motion",
              "; ".join(f"z = {name}: bias at most {percent(bias[name])} "
                        f"({sure[name]:.1f} standard errors), rms {percent(spread[name])}"
                        for name in slips.MEASURED),
              verdict(*(sure[name] < 3.0 and bias[name] < 0.005 for name in slips.MEASURED)),
              f"paper's noise at 100 Hz, clay and loam, both tracks, {slip.seeds} vehicles each"),
        Claim("8.3.2, fig. 33", "it leaves the true slip for a while on rapid changes of speed",
              "; ".join(f"z = {name}: rms {percent(peak[name])}" for name in slips.MEASURED),
              verdict(*(peak[name] > 1.5 * spread[name] for name in slips.MEASURED)),
              "sandy loam, speed oscillating by 1 m/s within 2 s; on firm clay the slip changes "
              "too little for it"),
    ]  # fmt: skip


def soil_claims(results: Results) -> list[Claim]:
    """Section 8.3.3."""
    case = soils.CASES.index(soils.Case("manoeuvre", "changing"))
    circle = soils.CASES.index(soils.Case("circle", "changing"))
    clay = soils.CASES.index(soils.Case("manoeuvre", "heavy clay"))
    printed = soils.quality(results.soil["printed"], case)
    ours = {name: soils.quality(found, case) for name, found in results.soil.items()}
    steady = {name: soils.quality(found, circle) for name, found in results.soil.items()}
    firm = {name: soils.quality(found, clay) for name, found in results.soil.items()}
    little = min(sigma for sigma in results.soil_noise["heavy clay"] if sigma > 0.0)
    disturbed = soils.quality(results.soil_noise["heavy clay"][little], 0)
    slip = results.soil["ideal"].slip[int(soils.RECOVERY / PERIOD) :, clay].max()
    windows = {n: soils.quality(found, 0) for n, found in results.soil_window.items()}
    fifty, shorter = windows[WINDOW], [q for n, q in windows.items() if n < WINDOW]
    return [
        Claim("8.3.3, figs 34, 35", "GNR finds F_max and K very accurately",
              f"true slips: {percent(printed.effort)} and {percent(printed.modulus)}; rtk sensors "
              f"{percent(ours['rtk'].effort)} and {percent(ours['rtk'].modulus)}; paper's "
              f"{percent(ours['strawa'].effort)} and {percent(ours['strawa'].modulus)}",
              verdict(printed.effort < 0.01, ours["strawa"].effort < 0.05),
              "with noise-free slips only; with noise this project's fit and the slips of the UKF"),
        Claim("8.3.3, figs 34, 35", "it adapts to a change almost instantly",
              f"within 10 % after {printed.adapted:.2g} s", verdict(printed.adapted < 1.0),
              "true slips; the window of fifty samples at 100 Hz is 0.5 s long"),
        Claim("8.3.3, fig. 36", "at most twenty iterations; high error mainly without convergence",
              f"error {percent(printed.error_failed)} without convergence "
              f"({percent(printed.failed)} of the steps), else {percent(printed.error_converged)}",
              verdict(printed.error_failed > 3.0 * printed.error_converged),
              "windows that mix two soils; the mean is "
              f"{printed.iterations:.1f} iterations"),
        Claim("8.3.3", "a window of fifty samples is robust",
              "; ".join(f"{n}: {percent(q.failed)} without convergence, F_max {percent(q.effort)}"
                        for n, q in windows.items()),
              verdict(fifty.effort < min(q.effort for q in shorter)),
              f"printed method, changing ground, {soils.WINDOW_NOISE:g} of white noise on the "
              "slip; a longer window averages more and takes as long as it is to forget"),
        Claim("8.3.3", "steady motion identifies the soil better than rapid manoeuvres",
              "; ".join(f"{name}: F_max {percent(steady[name].effort)} on the circle, "
                        f"{percent(ours[name].effort)} on the manoeuvre"
                        for name in ("rtk", "strawa")),
              verdict(*(steady[name].effort < ours[name].effort for name in ("rtk", "strawa"))),
              "this project's fit, slips of the UKF"),
        Claim("8.3.3, Table 2", "(not in the paper) on firm clay only F_max / K is observable",
              f"printed method, true slips: {percent(firm['printed'].effort)}; with "
              f"{little:g} of noise on the slip F_max {percent(disturbed.effort)}, F_max / K "
              f"{percent(disturbed.stiffness)}; this project's says \"ratio only\" in "
              f"{percent(firm['ideal'].ratio_only)} of the time",
              "-", f"slips below {percent(float(slip))} are on the straight part of S (7)"),
    ]  # fmt: skip


def claims(results: Results) -> list[Claim]:
    """All, in the order of the paper."""
    return [
        *controller_claims(results),
        *identification_claims(results),
        *slip_claims(results),
        *soil_claims(results),
    ]
