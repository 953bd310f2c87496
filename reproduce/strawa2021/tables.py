"""The tables of the page below the claims: every condition, one line each."""

import math

from reproduce.paper_page import Rows, percent
from reproduce.strawa2021 import control
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import slip as slips
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.control import rms
from reproduce.strawa2021.results import Results


def seconds(value: float) -> str:
    """A time; "never" when there is none."""
    return f"{value:.1f} s" if math.isfinite(value) else "never"


def sweep_table(results: Results) -> Rows:
    """Figure 17 in numbers."""
    rows = [["path", "factor of (20)", "mass wrong by half [m]", "inertia wrong by half [m]"]]
    for (way, factor), surface in results.sweep.items():
        mass, inertia = surface.along()
        rows.append([way, f"{factor:g}", f"{mass:.2g}", f"{inertia:.2g}"])
    return rows


def identification_table(results: Results) -> Rows:
    """Section 8.3.1, one line per condition."""
    rows = [
        ["ground", "lateral model", "sensors", "factor of (20)", "regression",
         "mass, straight: worst",
         "mass, spiral: rms", "worst", "leaves 5 % at", "inertia: rms", "mu_l: mean error", "rms",
         "mu_t: mean error", "rms", "path RMSE [m]"],
    ]  # fmt: skip
    for c, run in results.identification.items():
        head = [c.ground, c.lateral, c.sensors, f"{c.factor:g}", ident.NAMES[c.kind]]
        if c.kind == "fixed":
            rows.append([*head, *(["-"] * 9), f"{rms(run.error):.2g}"])
            continue
        q = ident.quality(run)
        rows.append(
            [*head, percent(q.mass_straight_worst), percent(q.mass_spiral),
             percent(q.mass_spiral_worst), seconds(q.exceeds), percent(q.inertia),
             f"{q.longitudinal_bias:+.2g}", f"{q.longitudinal_rms:.2g}",
             f"{q.lateral_bias:+.2g}", f"{q.lateral_rms:.2g}", f"{q.rmse:.2g}"],
        )  # fmt: skip
    return rows


def path_table(results: Results) -> Rows:
    """Mass error over speed and final radius."""
    rows = [["regression", "speed [m/s]", "final radius [m]", "straight: worst", "spiral: rms",
             "leaves 5 % at", "inertia: rms"]]  # fmt: skip
    for kind, found in results.by_path.items():
        rows += [
            [ident.NAMES[kind], f"{speed:g}", f"{radius:g}", percent(q.mass_straight_worst),
             percent(q.mass_spiral), seconds(q.exceeds), percent(q.inertia)]
            for (speed, radius), q in found.items()
        ]  # fmt: skip
    return rows


def noise_table(results: Results) -> Rows:
    """Mass error over noise and excitation."""
    rows = [["regression", "noise / paper's", "speed amplitude [m/s]", "straight: worst",
             "spiral: worst", "inertia: rms"]]  # fmt: skip
    for kind, found in results.by_noise.items():
        rows += [
            [ident.NAMES[kind], f"{noise:g}", f"{amplitude:g}", percent(q.mass_straight_worst),
             percent(q.mass_spiral_worst), percent(q.inertia)]
            for (noise, amplitude), q in found.items()
        ]  # fmt: skip
    return rows


def start_table(results: Results) -> Rows:
    """Mass error over the speed at the start."""
    rows = [["regression", "speed at the start [m/s]", "straight: worst", "straight: rms",
             "spiral: worst"]]  # fmt: skip
    for kind, found in results.by_start.items():
        rows += [
            [ident.NAMES[kind], f"{start:g}", percent(q.mass_straight_worst),
             percent(q.mass_straight), percent(q.mass_spiral_worst)]
            for start, q in found.items()
        ]  # fmt: skip
    return rows


def slip_table(results: Results) -> Rows:
    """Section 8.3.2, one line per case, measurement and track."""
    rows = [["speed", "soil", "pose rate [Hz]", "z", "track", "true slip", "steady: bias",
             "steady: rms", "rapid: bias", "rapid: rms"]]  # fmt: skip

    def text(q: slips.Quality) -> list[str]:
        if math.isnan(q.rms):
            return ["-", "-"]
        return [f"{100 * q.bias:+.2f} ± {100 * q.uncertainty:.2f} %", percent(q.rms)]

    for i, case in enumerate(results.slip.cases):
        for name in slips.MEASURED:
            for side in slips.SIDES:
                steady, rapid = (
                    slips.quality(results.slip, i, name, side, rapid) for rapid in (False, True)
                )
                rows.append([case.speed, case.soil, f"{case.rate:g}", name, side,
                             percent(steady.true), *text(steady), *text(rapid)])  # fmt: skip
    return rows


_METHODS = {
    "printed": "printed method, true slips",
    "ideal": "this project's, true slips",
    "rtk": "this project's, rtk sensors",
    "strawa": "this project's, paper's sensors",
}
_SOIL_HEAD = ["F_max", "K", "F_max / K", "within 10 % after", "iterations", "without convergence",
              "ratio only"]  # fmt: skip


def _soil_row(q: soils.Quality) -> list[str]:
    return [percent(q.effort), percent(q.modulus), percent(q.stiffness), seconds(q.adapted),
            f"{q.iterations:.1f}", percent(q.failed), percent(q.ratio_only)]  # fmt: skip


def soil_table(results: Results) -> Rows:
    """Section 8.3.3, one line per method and case."""
    rows = [["method", "path", "ground", *_SOIL_HEAD]]
    for method, found in results.soil.items():
        for i, case in enumerate(soils.CASES):
            quality = soils.quality(found, i)
            rows.append([_METHODS[method], case.way, case.ground, *_soil_row(quality)])
    return rows


def soil_noise_table(results: Results) -> Rows:
    """The printed method over the noise of the slip."""
    rows = [["ground", "sigma of the slip", *_SOIL_HEAD[:-1]]]
    for ground, found in results.soil_noise.items():
        for sigma, one in found.items():
            rows.append([ground, f"{sigma:g}", *_soil_row(soils.quality(one, 0))[:-1]])
    return rows


def soil_window_table(results: Results) -> Rows:
    """The printed method over its window."""
    rows = [["window [samples]", *_SOIL_HEAD[:-1]]]
    for window, one in results.soil_window.items():
        rows.append([f"{window}", *_soil_row(soils.quality(one, 0))[:-1]])
    return rows


def control_table(results: Results) -> Rows:
    """Sections 8.1 and 8.2."""
    return control.table(results.control)
