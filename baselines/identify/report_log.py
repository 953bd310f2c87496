"""What was identified: a set of parameters, in words what a log cannot tell, and a page.

    {"make": {"vehicle": {...}}}     arguments of an environment: gymnasium.make(id, **set["make"])
    {"ranges": {name: [low, high]}}  95 % intervals of what is determined, for `uncertainty=`
    {"parameters": {name: {...}}}    value, deviation, interval, verdict of everything
    {"contradictions": [...]}        why the log is not one of this vehicle and model; then there is
                                     no "make" and no range
What a log does not determine stays at its nominal value. The strength of a soil is one number in
the log, F_max = c A + (m g / 2) tan phi; the friction angle is kept as far as the cohesion stays
positive. The page needs no other file: tables and figures.
"""

import math
from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from baselines.identify.identify_log import CONSTANT, EQUATION, LEARNED, NORMAL, SOIL, Identified
from tracked_env.benchmark.figures import PALETTE, STYLE, new_figure, svg_text
from tracked_env.benchmark.table_model import Drawing, Section, Table, inline_svg, page_text
from tracked_env.physics.parameters import RANGES
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.vehicles import vehicle_toml

WHITE_LAGS = 50  # [samples] of the autocorrelation
EXPLAINED = (0.7, 1.5)  # [-] rms of residuals whose data sheet is right
COHESIVE = 0.02  # [-] share of the log beyond the largest mu_t from which on it is worth a word
REFUSED = 0.05  # [-] share of samples from which on outliers are worth a word
OUTLYING = 4.0  # [-] residuals beyond it count as that large
CORRELATED = 0.2  # [-] autocorrelation from which on residuals hang together
NAMES = {
    "mass": ("mass", "kg"),
    "inertia": ("yaw inertia", "kg m^2"),
    "longitudinal_resistance": ("motion resistance mu_l", "-"),
    "lateral_resistance": ("lateral resistance mu_t", "-"),
    "effort_maximum": ("soil strength F_max", "N"),
    "shear_deformation_modulus": ("shear deformation modulus K", "m"),
}
POINTS = 600  # of a curve: more are not seen
ESTIMATE, CONSTANT_LINE = PALETTE[1], PALETTE[0]
FILES = {
    "parameters.json": "the set of parameters, for gymnasium.make(id, **set['make'])",
    "identification.csv": "estimates, deviations, excitation and filtered motion of every step",
}


# --- the set of parameters ------------------------------------------------------------------


def _in_range(name: str, value: float) -> float:
    return min(max(value, RANGES[name].low), RANGES[name].high)


def _soil(identified: Identified, mass: float) -> dict[str, float]:
    """cohesion [Pa] and friction_angle [rad] that give the F_max of the log."""
    nominal, load = identified.nominal, 0.5 * mass * GRAVITY
    strength, angle = identified.parameters["effort_maximum"].value, nominal.friction_angle
    area = nominal.track_width * nominal.contact_length
    cohesion = (strength - load * math.tan(angle)) / area
    if cohesion < 0.0:
        cohesion, angle = 0.0, math.atan(strength / load)
    soil = {"cohesion": cohesion, "friction_angle": angle}
    return {name: _in_range(name, value) for name, value in soil.items()}


def contradictions(identified: Identified) -> list[str]:
    """What speaks against a log of this vehicle and model, a sentence each."""
    parameters = identified.parameters
    against = {EQUATION[n] for n in CONSTANT if parameters[n].against == "contradicted"}
    sentences = [
        f"The {name} equation does not hold in this log: its residuals are {fit.size:.3g} times as "
        "large as the data sheet allows, and follow each other "
        f"(autocorrelation {fit.correlation:.2f}). Check signs, sides and units of torques and "
        "accelerations, their delays, and the geometry of --vehicle."
        for name, fit in identified.misfits.items()
        if name in against
    ]
    for name in ("mass", "inertia"):
        p, (label, unit) = parameters[name], NAMES[name]
        if p.against == "at its bound" and p.deviation <= LEARNED * p.prior_deviation:
            sentences.append(
                f"The {label} ends at the bound of its search, {p.value:.4g} {unit}, and is no "
                f"result. Is the nominal one of --vehicle, {getattr(identified.nominal, name):g}, "
                "far off, or are the torques on another scale?"
            )
    return sentences


def _determined(identified: Identified) -> list[str]:
    """Names of what the log determines, weakly or well."""
    verdicts = {name: p.verdict for name, p in identified.parameters.items()}
    return [name for name, verdict in verdicts.items() if verdict in ("determined", "weakly")]


def parameter_set(identified: Identified) -> dict[str, Any]:
    """The set as JSON has it; without "make" and ranges where the log contradicts the model."""
    parameters, determined = identified.parameters, _determined(identified)
    vehicle = {name: float(value) for name, value in identified.nominal._asdict().items()}
    ranges = {}
    for name in determined:
        if name != "effort_maximum":
            p = parameters[name]
            vehicle[name] = _in_range(name, p.value)
            ranges[name] = [_in_range(name, end) for end in (p.low, p.high)]
    if "effort_maximum" in determined:
        vehicle |= _soil(identified, vehicle["mass"])
    usable: dict[str, Any] = {"make": {"vehicle": vehicle}, "ranges": ranges}
    if against := contradictions(identified):
        usable = {"contradictions": against}
    columns = ("value", "deviation", "low", "high", "verdict", "changed")
    rows = {
        name: {"unit": NAMES[name][1], **{key: getattr(p, key) for key in columns}}
        for name, p in parameters.items()
    }
    return {**usable, "parameters": rows, "not_told": limitations(identified)}


def vehicle_file(parameters: dict[str, Any]) -> str:
    """The set as a file of a vehicle; empty where the log contradicts the model."""
    if "make" not in parameters:
        return ""
    rows, vehicle = parameters["parameters"], parameters["make"]["vehicle"]
    notes = {
        name: f"{rows[name]['verdict']}, {rows[name]['low']:.4g} to {rows[name]['high']:.4g}"
        for name in vehicle
        if name in parameters["ranges"]
    }
    return vehicle_toml(vehicle, notes)


def autocorrelation(residuals: Any) -> Any:
    """Autocorrelation (WHITE_LAGS,) [-] from lag 1 on."""
    centred = residuals - residuals.mean()
    power = float(centred @ centred) or 1.0
    return np.array([centred[k:] @ centred[:-k] / power for k in range(1, WHITE_LAGS + 1)])


def limitations(identified: Identified) -> list[str]:
    """What the log cannot tell, and what speaks against the model, a sentence each."""
    parameters, sentences = identified.parameters, contradictions(identified)
    unknown = set() if sentences else set(parameters) - set(_determined(identified))
    if {"mass", "longitudinal_resistance"} & unknown:
        text = (
            "Mass and motion resistance are not told apart: the log has too little speeding up, "
            "braking and turning. At constant speed only their product shows"
        )
        force, deviation = identified.resistance_force
        if deviation < 0.2 * force:
            text += f", the resisting force m g mu_l = {force:.0f} +- {deviation:.0f} N"
        sentences.append(f"{text}.")
    if {"inertia", "lateral_resistance"} & unknown:
        sentences.append(
            "Yaw inertia and lateral resistance are not determined: they show in turns, the inertia"
            " in turns that begin and end. They stay at their nominal values."
        )
    if set(SOIL) & unknown:
        text = (
            "Soil strength and shear deformation modulus are not told apart: the tracks slipped "
            "too little"
        )
        stiffness, deviation = identified.stiffness
        if deviation < 0.2 * stiffness:
            text += f". Their ratio is F_max / K = {stiffness:.3g} +- {deviation:.2g} N/m"
        sentences.append(f"{text}. Full torque from rest, or a tight turn, would show them.")
    if changing := [NAMES[name][0] for name in CONSTANT if parameters[name].changed]:
        sentences.append(
            f"Within the log {', '.join(changing)} changed, or an equation does not hold there. "
            "The values are those at the end, with the deviations of a vehicle that may change."
        )
    most = RANGES["lateral_resistance"].high
    cohesive = float(np.mean(identified.series["lateral_resistance"][0] > most))
    if cohesive > COHESIVE:
        sentences.append(
            f"In {100.0 * cohesive:.0f} % of the log the resistance to a turn is more than a mu_t "
            f"of {most:g} explains. Cohesion of firm soil does that: it does not grow with the "
            "weight, but with the curvature, and hides the inertia. plant='distributed' models it."
        )
    for name, residuals in identified.residuals.items():
        if len(residuals) >= 4 * WHITE_LAGS and not identified.misfits[name].contradicts:
            sentences += _doubts(name, identified)
    for name, estimate in identified.estimates.items():
        share = float(np.mean(estimate.status == 2))
        if name != "slip" and share > REFUSED:
            sentences.append(
                f"{share:.0%} of the samples of the {name} estimator were refused as outliers."
            )
    sentences.append(
        "Cohesion and friction angle act through F_max alone under one load; the set has the "
        "nominal friction angle where it can."
    )
    return sentences


def _doubts(name: str, identified: Identified) -> list[str]:
    """What the residuals of an equation say against the data sheet or the model."""
    residuals, sentences = np.clip(identified.residuals[name], -OUTLYING, OUTLYING), []
    # A change leaves residuals until it is learned; the middle size has few of them.
    changed = any(p.changed for p in identified.parameters.values())
    size = identified.misfits[name].size if changed else float(np.sqrt(np.mean(residuals**2)))
    if not EXPLAINED[0] <= size <= EXPLAINED[1]:
        cause = "more noise than" if size > 1.0 else "less noise than"
        sentences.append(
            f"Residuals of the {name} equation are {size:.2g} times what the data sheet says, "
            f"where 1 is expected: the log has {cause} --sensors state"
            + (", or the model lacks something." if size > 1.0 else ".")
        )
    first = float(np.abs(autocorrelation(residuals)[:5]).max())
    if first > CORRELATED and not changed:
        sentences.append(
            f"Residuals of the {name} equation are not white (autocorrelation {first:.2f}): "
            "the intervals are too narrow."
        )
    return sentences


# --- the page -------------------------------------------------------------------------------


def digits(value: float, count: int) -> str:
    """A number with so many significant digits, without an exponent."""
    return np.format_float_positional(value, count, unique=False, fractional=False, trim="-")


def result_rows(identified: Identified) -> list[list[str]]:
    """Rows of cells, the header first: the parameters."""
    names = ["parameter", "unit", "value", "standard deviation", "95 % interval", "nominal"]
    rows = [[*names, "verdict"]]
    for name, p in identified.parameters.items():
        nominal = getattr(identified.nominal, name, identified.series[name][0][0])
        interval = f"{digits(p.low, 4)} to {digits(p.high, 4)}"
        value = [digits(p.value, 4), digits(p.deviation, 2), interval, digits(nominal, 4)]
        rows.append([*NAMES[name], *value, p.verdict + (", changes" if p.changed else "")])
    return rows


def over_time(identified: Identified) -> dict[str, Any]:
    """Estimates, deviations, excitation and filtered motion of every step, (T,) by name."""
    series: dict[str, Any] = {"time": identified.log.time}
    for name, (value, deviation) in identified.series.items():
        series |= {name: value, f"{name}_deviation": deviation}
    series |= {f"{name}_excitation": e.excitation for name, e in identified.estimates.items()}
    names = ("x", "y", "yaw", "v_x", "v_y", "yaw_rate")
    return series | dict(zip(names, identified.motion.T, strict=True))


def _residual_rows(identified: Identified) -> list[list[str]]:
    """Rows of cells, the header first: residuals of the two regressions."""
    rows = [["equation", "samples", "mean", "rms", "beyond 1.96", "autocorrelation at lag 1"]]
    rows[0].append(f"lags 1 to {WHITE_LAGS} beyond the band")
    for name, r in identified.residuals.items():
        cells = ["-"] * 5
        if len(r) >= 4 * WHITE_LAGS:
            correlation = autocorrelation(r)
            outside = float(np.mean(np.abs(correlation) > NORMAL / np.sqrt(len(r))))
            cells = [f"{r.mean():.2f}", f"{np.sqrt(np.mean(r**2)):.2f}"]
            cells += [f"{np.mean(np.abs(r) > NORMAL):.1%}", f"{correlation[0]:.2f}"]
            cells.append(f"{outside:.0%}")
        rows.append([name, f"{len(r)}", *cells])
    return rows


def page(identified: Identified, subject: str, facts: Mapping[str, str]) -> str:
    """The whole page; subject: name of the log, facts: where the numbers come from."""
    results = Table(
        "What the log says. Constant parameters of the whole log, or where one changes its value "
        "at the end; a deviation holds the noise and the biases of the data sheet",
        result_rows(identified),
    )
    residuals = Table(
        "Residuals of each sample by the estimates before it, over the standard deviation that the "
        "data sheet gives: the rms is 1 and the autocorrelation 0 where model and data sheet are "
        f"right; 5 % of {WHITE_LAGS} lags lie beyond the band by chance",
        _residual_rows(identified),
    )
    log = identified.log
    sections = [
        Section("Parameters", "parameters", [results]),
        Section("What the log cannot tell", "untold", notes=limitations(identified)),
        Section("Over time", "time", figures=[_drawing(identified)]),
        Section("Residuals", "residuals", [residuals]),
        Section("The log", "log", notes=log.notes),
        Section("Provenance", "provenance", facts=facts),
        Section("Files", "files", links=FILES),
    ]
    introduction = [
        f"{log.time[-1]:.0f} s of driving, {len(log.time)} steps of {1e3 * log.period:.3g} ms."
    ]
    return page_text("Identification", subject, introduction, sections, "parameter")


def _plot_band(axes: Axes, identified: Identified, name: str) -> None:
    """One quantity with its 95 % band; the axis shows the band once it is narrower."""
    time, (value, deviation) = identified.log.time, identified.series[name]
    k = np.unique(np.linspace(0, len(time) - 1, POINTS).astype(int))
    time, value, deviation = time[k], value[k], deviation[k]
    low, high = value - NORMAL * deviation, value + NORMAL * deviation
    if name in SOIL:
        factor = np.exp(NORMAL * deviation / value)
        low, high = value / factor, value * factor
    axes.fill_between(time, low, high, color=ESTIMATE, alpha=0.2, linewidth=0.0)
    axes.plot(time, value, color=ESTIMATE, linewidth=1.2)
    later = slice(len(k) // 8, None)
    bottom, top = float(np.min(low[later])), float(np.max(high[later]))
    margin = 0.1 * (top - bottom) + 1e-9
    axes.set_ylim(bottom - margin, top + margin)


def _drawing(identified: Identified) -> Drawing:
    """Parameters over time."""
    title = "Parameters over time"
    text = "Line: estimate, which may change at any moment; band: 95 %. Dashed: constant value."
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        figure, panels = new_figure((2.7, 1.4), 3, 2, gap=(0.75, 0.4), sharex=True)
        for axes, name in zip(panels.flat, (*CONSTANT, *SOIL), strict=True):
            _plot_band(axes, identified, name)
            p = identified.parameters[name]
            if name in CONSTANT and not p.changed:
                axes.axhline(p.value, color=CONSTANT_LINE, linestyle="--", linewidth=1.0)
            axes.set_title("{} [{}]".format(*NAMES[name]), loc="left", fontsize="medium")
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        return Drawing(title, text, inline_svg(svg_text(figure, title), title))
