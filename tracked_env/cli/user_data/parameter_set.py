"""What was identified as a set of parameters, and in words what a log cannot tell.

    {"make": {"vehicle": {...}}}     arguments of an environment: gymnasium.make(id, **set["make"])
    {"ranges": {name: [low, high]}}  95 % intervals of what is determined, for `uncertainty=`
    {"parameters": {name: {...}}}    value, deviation, interval, verdict of everything
    {"contradictions": [...]}        why the log is not one of this vehicle and model; then there is
                                     no "make" and no range
What a log does not determine stays at its nominal value. The strength of a soil is one number in
the log, F_max = c A + (m g / 2) tan phi; the friction angle is kept as far as the cohesion stays
positive.
"""

import math
from typing import Any

import numpy as np

from tracked_env.cli.user_data.log_identification import (
    CONSTANT,
    EQUATION,
    LEARNED,
    SOIL,
    Identified,
)
from tracked_env.physics.parameters import RANGES
from tracked_env.physics.terramechanics import GRAVITY

WHITE_LAGS = 50  # [samples] of the autocorrelation
EXPLAINED = (0.7, 1.5)  # [-] rms of residuals whose data sheet is right
COHESIVE = 0.02  # [-] share of the log beyond the largest mu_t from which on it is worth a word
REFUSED = 0.05  # [-] share of samples from which on outliers are worth a word
OUTLYING = 4.0  # [-] residuals beyond it count as that large
CORRELATED = 0.2  # [-] autocorrelation from which on residuals hang together
NAMES = {
    "mass": ("mass", "kg"), "inertia": ("yaw inertia", "kg m^2"),
    "longitudinal_resistance": ("motion resistance mu_l", "-"),
    "lateral_resistance": ("lateral resistance mu_t", "-"),
    "effort_maximum": ("soil strength F_max", "N"),
    "shear_deformation_modulus": ("shear deformation modulus K", "m"),
}  # fmt: skip


def soil_of(identified: Identified, mass: float) -> dict[str, float]:
    """cohesion [Pa] and friction_angle [rad] that give the F_max of the log."""
    nominal = identified.nominal
    area = nominal.track_width * nominal.contact_length
    load = 0.5 * mass * GRAVITY
    strength = identified.found["effort_maximum"].value
    angle = nominal.friction_angle
    cohesion = (strength - load * math.tan(angle)) / area
    if cohesion < 0.0:
        cohesion, angle = 0.0, math.atan(strength / load)
    found = {"cohesion": cohesion, "friction_angle": angle}
    return {name: min(max(of, RANGES[name].low), RANGES[name].high) for name, of in found.items()}


def determined(identified: Identified) -> tuple[str, ...]:
    """Names of what the log determines, weakly or well."""
    return tuple(n for n, of in identified.found.items() if of.verdict in ("determined", "weakly"))


def contradictions(identified: Identified) -> list[str]:
    """What speaks against a log of this vehicle and model, a sentence each."""
    said = [
        f"The {name} equation does not hold in this log: its residuals are {fit.size:.3g} times as "
        "large as the data sheet allows, and follow each other "
        f"(autocorrelation {fit.following:.2f}). Check signs, sides and units of torques and "
        "accelerations, their delays, and the geometry of --vehicle."
        for name, fit in identified.misfits.items()
        if any(identified.found[of].against == "contradicted" for of in CONSTANT
               if EQUATION[of] == name)
    ]  # fmt: skip
    for name in ("mass", "inertia"):
        of = identified.found[name]
        if of.against == "at its bound" and of.deviation <= LEARNED * of.prior_deviation:
            said.append(
                f"The {NAMES[name][0]} ends at the bound of its search, {of.value:.4g} "
                f"{NAMES[name][1]}, and is no result. Is the nominal one of --vehicle, "
                f"{getattr(identified.nominal, name):g}, far off, or are the torques on another "
                "scale?"
            )
    return said


def parameter_set(identified: Identified) -> dict[str, Any]:
    """The set as JSON has it; without "make" and ranges where the log contradicts the model."""
    known, found = determined(identified), identified.found
    against = contradictions(identified)
    vehicle = {name: float(value) for name, value in identified.nominal._asdict().items()}
    ranges = {}
    for name in known:
        if name != "effort_maximum":
            low, high = RANGES[name].low, RANGES[name].high
            vehicle[name] = min(max(found[name].value, low), high)
            ranges[name] = [min(max(x, low), high) for x in (found[name].low, found[name].high)]
    if "effort_maximum" in known:
        vehicle |= soil_of(identified, vehicle["mass"])
    usable = {"contradictions": against} if against else {
        "make": {"vehicle": vehicle}, "ranges": ranges
    }  # fmt: skip
    return {
        **usable,
        "parameters": {
            name: {
                "unit": NAMES[name][1], "value": of.value, "deviation": of.deviation,
                "low": of.low, "high": of.high, "verdict": of.verdict, "changed": of.changed,
            }
            for name, of in found.items()
        },
        "not_told": untold(identified),
    }  # fmt: skip


def autocorrelation(residuals: Any, lags: int = WHITE_LAGS) -> Any:
    """Autocorrelation (lags,) [-] from lag 1 on."""
    centred = residuals - residuals.mean()
    power = float(centred @ centred) or 1.0
    return np.array([centred[k:] @ centred[:-k] / power for k in range(1, lags + 1)])


def untold(identified: Identified) -> list[str]:
    """What the log cannot tell, and what speaks against the model, a sentence each."""
    found, said = identified.found, contradictions(identified)
    lost = set(found) - set(determined(identified))
    if said:
        lost = set()
    if {"mass", "longitudinal_resistance"} & lost:
        force, deviation = identified.resistance_force
        text = "Mass and motion resistance are not told apart: the log has too little speeding up, \
braking and turning. At constant speed only their product shows"
        if deviation < 0.2 * force:
            text += f", the resisting force m g mu_l = {force:.0f} +- {deviation:.0f} N"
        said.append(f"{text}.")
    if {"inertia", "lateral_resistance"} & lost:
        said.append(
            "Yaw inertia and lateral resistance are not determined: they show in turns, the inertia"
            " in turns that begin and end. They stay at their nominal values."
        )
    if set(SOIL) & lost:
        text = "Soil strength and shear deformation modulus are not told apart: the tracks slipped "
        text += "too little"
        stiffness, deviation = identified.stiffness
        if deviation < 0.2 * stiffness:
            text += f". Their ratio is F_max / K = {stiffness:.3g} +- {deviation:.2g} N/m"
        said.append(f"{text}. Full torque from rest, or a tight turn, would show them.")
    changing = [NAMES[name][0] for name in CONSTANT if found[name].changed]
    if changing:
        said.append(
            f"Within the log {', '.join(changing)} changed, or an equation does not hold there. "
            "The values are those at the end, with the deviations of a vehicle that may change."
        )
    most = RANGES["lateral_resistance"].high
    cohesive = float(np.mean(identified.series["lateral_resistance"][0] > most))
    if cohesive > COHESIVE:
        said.append(
            f"In {100.0 * cohesive:.0f} % of the log the resistance to a turn is more than a mu_t "
            f"of {most:g} explains. Cohesion of firm soil does that: it does not grow with the "
            "weight, but with the curvature, and hides the inertia. plant='distributed' models it."
        )
    said += _against(identified)
    said.append(
        "Cohesion and friction angle act through F_max alone under one load; the set has the "
        "nominal friction angle where it can."
    )
    return said


def _against(identified: Identified) -> list[str]:
    """What speaks against model or data sheet."""
    said = []
    changed = any(of.changed for of in identified.found.values())
    for name, found in identified.residuals.items():
        if len(found) < 4 * WHITE_LAGS or identified.misfits[name].contradicts:
            continue
        residuals = np.clip(found, -OUTLYING, OUTLYING)
        # A change leaves residuals until it is learned; the middle size has few of them.
        size = float(np.sqrt(np.mean(residuals**2)))
        size = identified.misfits[name].size if changed else size
        if not EXPLAINED[0] <= size <= EXPLAINED[1]:
            cause = "more noise than" if size > 1.0 else "less noise than"
            said.append(
                f"Residuals of the {name} equation are {size:.2g} times what the data sheet says, "
                f"where 1 is expected: the log has {cause} --sensors state"
                + (", or the model lacks something." if size > 1.0 else ".")
            )
        first = float(np.abs(autocorrelation(residuals)[:5]).max())
        if first > CORRELATED and not changed:
            said.append(
                f"Residuals of the {name} equation are not white (autocorrelation {first:.2f}): "
                "the intervals are too narrow."
            )
    for name, status in identified.status.items():
        share = float(np.mean(status == 2))
        if name != "slip" and share > REFUSED:
            said.append(
                f"{share:.0%} of the samples of the {name} estimator were refused as outliers."
            )
    return said
