"""What comes out of the claims of sections 4.5 and 8. The words stand in page.toml."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025 import slopes as closed
from reproduce.focchi2025.control import LENGTHS
from reproduce.focchi2025.load_models import LOADS
from reproduce.focchi2025.slopes import SIDE_SLOPE, STARTS, SlopeCase, Slopes, Tracking
from reproduce.paper_page import Outcome, percent, verdict
from tracked_env.physics.terramechanics import GRAVITY

PRINTED_GAP, PRINTED_LENGTH = 4.0, 15.6  # [m] F 8.1
PRINTED_COST = 11.0 / 0.49  # [-] nonuniform over uniform load
PRINTED_UC = (0.20, 0.20)  # [m] F 8.3: mean and final error of the unicycle controller
PRINTED_SLC = (0.059, 0.056)
PRINTED_PITCH = (-0.1, 0.2)  # [rad]


def identification_claims(slopes: Slopes) -> Iterator[Outcome]:
    """Section 4.5."""
    found = slopes.identification
    scores = {
        name: " / ".join(f"{one:.4f}" for one in values) for name, values in found.scores.items()
    }
    fine, level = found.scores["steps of 0.05"], found.scores["level ground"]
    values: dict[str, Any] = {
        "steady": found.steady,
        "fine": scores["steps of 0.05"],
        "level": scores["level ground"],
        "uniform": scores["uniform load"],
        "steepest": closed.STEEPEST,
        "fastest": closed.FASTEST,
        "friction": loads.FRICTION,
    }
    yield Outcome("gravity", verdict(float(fine.min()) > 0.99, float(level.min()) < 0.7), values)
    yield Outcome("ramps", "no", {"coarse": scores["steps of 0.13"]})
    up, flat, down = found.bend
    values = {"up": 1e3 * up[1], "flat": 1e3 * flat[1], "down": 1e3 * down[1], "bend": closed.BEND}
    values["share"] = percent(1.0 - found.uphill)
    yield Outcome("downhill", verdict(found.uphill < 0.2), values)
    ratio = found.side_slip / closed.GRADES
    bent = ratio[1] / ratio[1, 0]
    middle = int(np.argmin(np.abs(closed.GRADES - 0.2)))
    agrees = verdict(abs(bent[middle] - 1.0) < 0.1, abs(bent[-1] - 1.0) < 0.1)
    values = {"middle": bent[middle], "most": bent[-1], "size": 1e3 * abs(found.side_slip[1, -1])}
    ends = {"first": closed.GRADES[0], "last": closed.GRADES[-1]}
    yield Outcome("proportional", agrees, {**values, **ends})
    agrees = verdict(*(abs(one[0] / flat[0] - 1.0) > 0.02 for one in (up, down)))
    yield Outcome("rotation", agrees, {"up": up[0], "flat": flat[0], "down": down[0]})


def load_claims(slopes: Slopes) -> Iterator[Outcome]:
    """Sections 2.2.2 and 8.1."""
    first, scripted = slopes.grounds[0], ""
    if slopes.scripted:
        runs = [slopes.scripted[load] for load in LOADS]
        gap, length = loads.gap(*runs)[0], loads.length(runs[0])[0]
        scripted = f" (from (19, 3), where their 8.1 starts: {gap:.1f} m over {length:.1f} m)"
    for ground in slopes.grounds:
        parts, agreed = [], []
        for commands in loads.COMMANDS:
            runs = [slopes.open_loop[ground.name, commands, load] for load in LOADS]
            gaps, lengths = loads.gap(*runs), loads.length(runs[0])
            parts += [
                f"{commands}, heading {h:g}: {gap:.2f} m over {length:.2f} m "
                f"({percent(gap / length)})"
                for h, gap, length in zip(loads.HEADINGS, gaps, lengths, strict=True)
            ]
            near = abs(gaps[0] - PRINTED_GAP) < 0.5 and abs(lengths[0] - PRINTED_LENGTH) < 0.1
            agreed.append(bool(near))
        spread = slopes.spread[ground.name]
        values = {
            "ground": ground.name,
            "parts": "; ".join(parts),
            "scripted": scripted,
            "starts": STARTS,
            "median": np.median(spread),
            "high": np.percentile(spread, 90),
        }
        judged = ground is first and not slopes.missing
        yield Outcome("loads", verdict(*agreed) if judged else "-", values)
    printed, table = slopes.decay["as 8.1 prints"], slopes.decay["Table 2"]
    yield Outcome("damping", verdict(printed[0] < 2000.0), {"printed": printed, "table": table})
    plant, expected = slopes.side
    values = {"slope": SIDE_SLOPE, "plant": plant, "expected": expected}
    yield Outcome("side", verdict(plant > 0.0, plant < 0.0), values)
    hilly = float(slopes.open_loop[first.name, "(53)", "nonuniform"].balance[:, 0].std())
    level = float(slopes.level.balance.std())
    turn = 2.0 * loads.SPEED * loads.TURN * loads.HEIGHT / (GRAVITY * 0.606)
    values = {"hilly": hilly, "level": level, "ground": first.name, "turn": turn}
    yield Outcome("dominates", verdict(hilly > 2.0 * level), values)
    ratio = slopes.cost["nonuniform"] / slopes.cost["uniform"]
    values = {**slopes.cost, "ratio": ratio, "printed": PRINTED_COST, "ground": first.name}
    yield Outcome("cost", "-", values)


def stiffening_claims(slopes: Slopes) -> Iterator[Outcome]:
    """Section 8.2."""
    k_n, runs = 1e-3, slopes.stiffening
    formula = {name: loads.foremost(*pair, loads.TOP_SPEED) for name, pair in loads.PAIRS.items()}
    off = [abs(formula[name] / loads.PRINTED_STIFFNESS - 1.0) for name in ("printed", "fits")]
    pairs = "; ".join(
        f"K_tp {pair[0]:g} s/m^2 and {pair[1]:g} m: {k_n * formula[name]:.1f} in closed form, "
        f"{k_n * float(runs[name, 'as coded'].stiffness.max()):.1f} in simulation"
        for name, pair in loads.PAIRS.items()
    )
    agrees = verdict(off[0] < 0.02, off[1] < 0.02)
    yield Outcome("stiffness", agrees, {"pairs": pairs, "off": [percent(one) for one in off]})
    soft, coded = runs["fits", "per track"], runs["fits", "as coded"]
    values = {
        "most": -coded.pitch.min(),
        "held": -coded.held,
        "balance": -coded.equilibrium,
        "softer": loads.PER_AREA["as coded"] / loads.PER_AREA["per track"],
        "soft": -soft.pitch.min(),
        "leaves": "the foremost patches leave the ground and " if soft.raised else "and ",
        "largest": k_n * float(soft.stiffness.max()),
    }
    yield Outcome("pitches", verdict(coded.pitch.min() < -0.01, coded.held < 0.0), values)


def both(found: Tracking) -> str:
    """Mean and final error in cm."""
    return f"{100.0 * found.mean:.1f} / {100.0 * found.final:.1f} cm"


def near(found: Tracking, printed: tuple[float, float]) -> list[bool]:
    """Whether mean and final error are within a quarter of the printed ones."""
    pairs = zip((found.mean, found.final), printed, strict=True)
    return [abs(ours / theirs - 1.0) < 0.25 for ours, theirs in pairs]


def tracking_claims(slopes: Slopes) -> Iterator[Outcome]:
    """Section 8.3."""
    numbers = {case: closed.tracking(run) for case, run in slopes.closed_loop.items()}
    kinds, heading = closed.KINDS, closed.HEADINGS[1]
    for ground in slopes.grounds:
        judged = ground is slopes.grounds[0] and not slopes.missing
        uc, flat, slope, other = (numbers[SlopeCase(ground.name, kind)] for kind in kinds)
        turned = [numbers[SlopeCase(ground.name, kind, heading=heading)] for kind in kinds]
        values = {"ground": ground.name, "uc": both(uc), "heading": heading}
        values["turned"] = ", ".join(map(both, turned))
        yield Outcome("slope_uc", verdict(*near(uc, PRINTED_UC)) if judged else "-", values)
        values = {"slope": both(slope), "other": both(other), "flat": both(flat)}
        agrees = verdict(all(near(slope, PRINTED_SLC)), all(near(other, PRINTED_SLC)))
        agrees = agrees if judged else "-"
        yield Outcome("slope_slc", agrees, {"ground": ground.name, **values})
    name = slopes.grounds[0].name
    rows = [numbers[SlopeCase(name, kind)] for kind in kinds]
    uniform = [numbers[SlopeCase(name, kind, "uniform")] for kind in kinds[:3]]
    values = {
        "ground": name,
        "nonuniform": rows[0].mean / rows[2].mean,
        "other": rows[0].mean / rows[3].mean,
        "uniform": uniform[0].mean / uniform[2].mean,
        "loads": ", ".join(map(both, uniform)),
        "short": both(numbers[SlopeCase(name, "uc", length=LENGTHS[0])]),
    }
    yield Outcome("slope_ratio", verdict(rows[0].mean > 2.5 * rows[2].mean), values)
    pitch = numbers[SlopeCase(name, "slope")].pitch
    agrees = verdict(*(abs(a - b) < 0.05 for a, b in zip(pitch, PRINTED_PITCH, strict=True)))
    agrees = "-" if slopes.missing else agrees
    yield Outcome("slope_pitch", agrees, {"ground": name, "pitch": pitch})


def outcomes(slopes: Slopes) -> Iterator[Outcome]:
    """All, in the order of the paper."""
    for part in (identification_claims, load_claims, stiffening_claims, tracking_claims):
        yield from part(slopes)
