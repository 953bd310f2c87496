"""What comes out of the claims of sections 4 to 7: every number is computed from the runs, and so
is every verdict. The words stand in page.toml.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from baselines.slip.slip_regression import Scores
from reproduce.focchi2025 import control
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025.control import BEGUN, LENGTHS, RESISTANCE, Case, Floats, Run, vehicle
from reproduce.focchi2025.planning import PRINTED_LEVELS
from reproduce.focchi2025.planning_loop import (
    AS_CODED,
    EXCHANGED,
    FROM_ZERO,
    MOVING,
    PAPER,
    PRINTED,
    REST,
    SHOWN,
    TIGHT,
    VARIABLE,
    WIDE,
    Pair,
    Planning,
    Tracked,
)
from reproduce.paper_page import Outcome, verdict

RATE = control.RATES[0]  # [Hz] of the paper's simulation
REAL = (0.91, 0.84, 0.961)  # R^2 of F for the real vehicle: beta_left, beta_right, alpha
GOAL = 0.20  # [-] largest loss of accuracy that a wrong assumed friction may leave
TURNS = (slice(2.5, 12.0), slice(13.0, 20.0))  # [s] of the chicane, without its jumps

UC_DP, SLC_DP, UC_CP, SLC_CP, UC_SLP, SLC_SLP = PRINTED
# Table 4 of F: e_xy [m] and e_phi [rad], mean and standard deviation of 100 goals.
TABLE_4 = {
    UC_DP: ((0.20, 0.096), (0.24, 0.089)), SLC_DP: ((0.089, 0.062), (0.40, 0.12)),
    UC_CP: ((0.090, 0.054), (0.056, 0.044)), SLC_CP: ((0.03, 0.022), (0.038, 0.046)),
    UC_SLP: ((0.11, 0.046), (0.18, 0.062)), SLC_SLP: ((0.055, 0.04), (0.14, 0.043)),
}  # fmt: skip
CLOTHOID_LONGER, OPTIMAL_LONGER, FAILED = 1.83, 1.31, 22  # Table 4: T over Dubins, plans
DURATIONS = {"dubins": 8.12, "clothoid": 9.07, "optimal, variable": 8.4}  # [s] 7.2, figure 16


def three(scores: Scores) -> str:
    """R^2 of beta_left, beta_right and alpha forward."""
    return " / ".join(f"{value:.4g}" for value in scores[:3])


def cm(value: float) -> str:
    """A length in cm."""
    return f"{100.0 * value:.1f} cm"


def identification_claims(found: ident.Identifications) -> Iterator[Outcome]:
    """Section 4 and 7.2.3."""
    simulated, real = found.simulated, found.measured
    low, middle, high = (found.by_friction[mu] for mu in ident.FRICTIONS)
    if simulated.held_out is None or simulated.unseen is None:
        yield Outcome("untrained", "-", {"missing": found.missing})
    else:
        held_out, unseen = simulated.held_out, simulated.unseen
        agrees = verdict(min(held_out[:3]) > 0.999, min(unseen[:3]) > 0.999)
        values = {"held_out": three(held_out), "unseen": three(unseen), "runs": len(low.v_x)}
        yield Outcome("simulated", agrees, values)
    brief = found.brief
    agrees = verdict(brief.determination[0] > 0.98, brief.determination[2] > 0.98)
    yield Outcome("two_seconds", agrees, {"brief": brief, "slow": found.brief_slow})
    if real is not None:
        if real.held_out is not None and real.unseen is not None:
            near = [abs(a - b) < 0.05 for a, b in zip(real.unseen[:3], REAL, strict=True)]
            values = {"unseen": three(real.unseen), "held_out": three(real.held_out)}
            yield Outcome("real", verdict(*near), values)
        beta = {n: (a.correlation[:2], a.slope[:2]) for n, a in found.against_measured.items()}
        lengths = "; ".join(
            f"{n:g} m: correlation {c.min():.2f}, real / simulated {s[0]:.2f} (left), {s[1]:.2f} "
            "(right)"
            for n, (c, s) in beta.items()
        )
        agrees = verdict(*(abs(s.mean() - 1.0) < 0.3 for _, s in beta.values()))
        yield Outcome("beta", agrees, {"lengths": lengths})
        behind, moved = found.behind[LENGTHS[-1]]
        alpha, each = found.against_measured[LENGTHS[-1]], [cm(one) for one in found.behind_each]
        values = {"alpha": alpha, "behind": cm(behind), "moved": moved, "each": each}
        yield Outcome("alpha", "yes", values)
    at_low, at_middle = ident.share_above(low, middle), ident.share_above(middle, high)
    agrees = verdict(at_low > 1.5, at_middle < 0.5 * (1.0 + at_low))
    yield Outcome("friction", agrees, {"low": at_low, "middle": at_middle})


def spiral_claims(spirals: dict[str, control.Spiral]) -> Iterator[Outcome]:
    """Figure 10."""
    uc, slc = spirals["uc"], spirals["slc"]
    yield Outcome("spiral", "-", {"beyond": control.beyond_after(vehicle())})
    half = len(uc.value) // 2
    late = {kind: float(one.run.distance[half:].max()) for kind, one in spirals.items()}
    values = {f"late_{kind}": cm(size) for kind, size in late.items()}
    values |= {f"end_{kind}": cm(one.run.distance[-1, 0]) for kind, one in spirals.items()}
    yield Outcome("converges", verdict(late["slc"] < 0.5 * late["uc"]), values)
    numbers = {"uc": uc, "slc": slc, "last": slc.value[-1], "period": 1e3 / control.SPIRAL_RATE}
    yield Outcome("lyapunov", verdict(slc.rises < 1e-3), numbers)


def prediction(
    runs: dict[Case, Run], predicted: dict[Case, tuple[Floats, Floats, Floats]], case: Case
) -> dict[str, tuple[float, float, float]]:
    """Figure 14: {channel: (rms actual, rms error in the turns, rms error within 1 s of jumps)}."""
    run = runs[case]
    actual = run.slip(vehicle(case.length, case.friction, case.resistance))
    turning, jumps = np.zeros((2, len(run.time)), dtype=bool)
    for part in TURNS:
        turning |= (run.time >= part.start) & (run.time < part.stop)
    for jump in (control.TURN_TIME, control.SWITCH_TIME):
        jumps |= (run.time >= jump) & (run.time < jump + 1.0)

    def rms(values: Floats, rows: np.ndarray) -> float:
        return float(np.sqrt(np.nanmean(np.square(values[rows])))) if rows.any() else math.nan

    names, sizes = ("beta_left", "beta_right", "alpha"), {}
    for name, true, expected in zip(names, actual, predicted[case], strict=True):
        error = true[:, 0] - expected
        sizes[name] = (rms(true[:, 0], turning), rms(error, turning), rms(error, jumps))
    return sizes


def chicane_claims(results: Any) -> Iterator[Outcome]:
    """Section 7.1."""
    numbers = {case: run.numbers() for case, run in results.chicane.items()}
    paper = {(kind, n): numbers[Case(kind, n, RATE)] for kind in control.KINDS for n in LENGTHS}
    short, long = LENGTHS
    plain = results.readings["v_max t / t_1", short, 0.0, "uc"]
    ramp = [results.readings["v_max t / t_1", n, RESISTANCE, "table"].largest for n in LENGTHS]
    pair = {"short": paper["uc", short], "long": paper["uc", long]}
    agrees = verdict(*(abs(paper["uc", n].largest - 0.1) < 0.03 for n in LENGTHS))
    yield Outcome("uc", agrees, {**pair, "begun": BEGUN, "plain": cm(plain.largest)})
    pair = {"short": paper["table", short], "long": paper["table", long]}
    agrees = verdict(*(paper["table", n].largest < 0.03 for n in LENGTHS))
    values = {"leaves": 1.0 / control.SPEED**2, "ramp": [cm(one) for one in ramp]}
    yield Outcome("slc", agrees, {**pair, **values})
    heading = {key: one.heading for key, one in paper.items()}
    text = "; ".join(
        f"{n:g} m: UC {heading['uc', n]:.3f}, SLC {heading['table', n]:.3f} rad" for n in LENGTHS
    )
    agrees = verdict(*(heading["table", n] < heading["uc", n] for n in LENGTHS))
    yield Outcome("orientation", agrees, {"lengths": text})
    shown = Case("table", long, RATE)
    slip = prediction(results.chicane, results.predicted, shown)
    share = [error / size for size, error, _ in slip.values()]
    jump = min(slip[name][2] / slip[name][1] for name in ("beta_left", "beta_right"))
    agrees = verdict(max(share[:2]) < 0.2, jump > 2.0, share[2] < 0.2)
    end = results.chicane[shown].time[-1]
    yield Outcome("predicted", agrees, {"share": share, "jump": jump, "rate": RATE, "end": end})
    yield from further_claims(results, numbers)


def further_claims(results: Any, numbers: dict[Case, control.Numbers]) -> Iterator[Outcome]:
    """Comparisons that the paper leaves open or does not make."""

    def largest(kind: str, length: float, **other: float) -> float:
        return numbers[Case(kind, length, **other)].largest  # type: ignore[arg-type]

    lines = []
    for n in LENGTHS:
        errors = [
            cm(largest(kind, n)) for kind in ("exponential", "exponential, slow", "uc", "table")
        ]
        lines.append(
            f"{n:g} m: {errors[0]} fitted to all runs, {errors[1]} to those within 4.6 rad/s, UC "
            f"{errors[2]}, regressor {errors[3]}"
        )
    fitted = ("exponential", "exponential, slow")
    agrees = verdict(*(largest(kind, n) < largest("uc", n) for kind in fitted for n in LENGTHS))
    scores = three(results.identification.simulated.exponential_fit)
    yield Outcome("exponential", agrees, {"scores": scores, "lengths": "; ".join(lines)})

    loss, wrong = [], []
    for length in LENGTHS:
        for true, assumed in control.SOILS:
            right = numbers[Case("table", length, friction=true, believed=true)]
            guess = numbers[Case("table", length, friction=true, believed=assumed)]
            online = numbers[Case("online", length, friction=true, believed=assumed)]
            loss += [online.largest / right.largest - 1.0, online.rmse / right.rmse - 1.0]
            wrong.append(guess.largest / right.largest)
    values = {"loss": 100 * max(loss), "least": min(wrong), "most": max(wrong)}
    yield Outcome("online", verdict(max(loss) < GOAL), values)

    ratios = []
    for kind in control.KINDS:
        for n in LENGTHS:
            by_rate = [largest(kind, n, rate=rate) for rate in control.RATES]
            ratios.append(max(by_rate) / min(by_rate))
    yield Outcome("rates", verdict(max(ratios) < 1.1), {"apart": 100 * (max(ratios) - 1)})
    free = {"resistance": 0.0, "believed_resistance": 0.0}
    text = "; ".join(
        f"{n:g} m: UC {cm(largest('uc', n))}, without {cm(largest('uc', n, **free))}; SLC "
        f"{cm(largest('table', n))}, without {cm(largest('table', n, **free))}"
        for n in LENGTHS
    )
    yield Outcome("rolling", "-", {"lengths": text})
    by_integrator = {key: run.numbers().largest for key, run in results.integrators.items()}
    apart = max(
        abs(error - by_integrator["Rosenbrock, 1 ms", kind])
        for (_, kind), error in by_integrator.items()
    )
    yield Outcome("integration", verdict(apart < 1e-3), {"apart": 1e3 * apart})


# Sections 6 and 7.2


def pair_numbers(found: dict[Pair, Tracked], *pairs: Pair) -> str:
    """Mean e_xy [m] and e_phi [rad] of pairs."""
    return ", ".join(
        f"{p.name} {found[p].distance.mean():.3f} / {found[p].heading.mean():.3f}" for p in pairs
    )


def near(ours: float, printed: tuple[float, float]) -> bool:
    """Whether a mean is within half a printed standard deviation of the printed one."""
    return abs(ours - printed[0]) <= 0.5 * printed[1]


def path_claims(results: Planning) -> Iterator[Outcome]:
    """Durations: figure 16 and Table 4."""
    durations = {pair.planner: job.trajectory.duration for pair, (job, _) in results.shown.items()}
    free = results.tracked[PAPER[LENGTHS[-1]]]
    values: dict[str, Any] = {
        "durations": " / ".join(f"{durations[name]:.3f}" for name in DURATIONS),
        "constant": durations["optimal"],
        "added": results.added,
        "unslipped": results.unslipped,
    }
    agrees = verdict(*(abs(durations[name] - t) < 0.05 for name, t in DURATIONS.items()))
    yield Outcome("durations", agrees, values)
    ratios = results.ratios
    agrees = verdict(abs(ratios[1.0] - CLOTHOID_LONGER) < 0.02)
    values = {"near": ratios[1.0], "far": ratios[2.0], "nearer": results.nearer}
    yield Outcome("clothoids", agrees, values)
    longer = float(free[SLC_SLP].duration.mean() / results.dubins.mean())
    wound, done = results.unwrapped, results.unwrapped.converged
    ratio = float(wound.duration[done].mean() / results.dubins[done].mean())
    agrees = verdict(*(abs(each - OPTIMAL_LONGER) < 0.03 for each in (longer, ratio)))
    turns = int(np.sum(wound.turns != 0.0))
    yield Outcome("longer", agrees, {"longer": longer, "ratio": ratio, "turns": turns})
    failed = len(done) - int(done.sum())
    yield Outcome("failed", verdict(failed >= FAILED), {"failed": failed, "plans": len(done)})


def tracking_claims(results: Planning) -> Iterator[Outcome]:
    """Table 4 and figure 17."""
    by_length = {length: results.tracked[setup] for length, setup in PAPER.items()}
    reasons = reasons_of(by_length)
    for pair, (distance, heading) in TABLE_4.items():
        ours = {n: found[pair] for n, found in by_length.items()}
        text = "; ".join(
            f"{n:g} m: {t.distance.mean():.3f} ± {t.distance.std():.3f} m, "
            f"{t.heading.mean():.3f} ± {t.heading.std():.3f} rad"
            for n, t in ours.items()
        )
        agrees = verdict(
            any(near(t.distance.mean(), distance) for t in ours.values()),
            any(near(t.heading.mean(), heading) for t in ours.values()),
        )
        values: dict[str, Any] = {"name": pair.name, "distance": distance, "heading": heading}
        yield Outcome("pair", agrees, {**values, "lengths": text, "reason": reasons[pair]})

    long, moving = by_length[LENGTHS[-1]], results.tracked[MOVING[LENGTHS[-1]]]
    worst = {n: max(PRINTED, key=lambda p: f[p].distance.mean()) for n, f in by_length.items()}
    values = {
        "worst": "; ".join(f"{n:g} m: {p.name}" for n, p in worst.items()),
        "radii": pair_numbers(long, *TIGHT, *WIDE),
        "saturated": 100 * long[UC_DP].saturated.mean(),
    }
    yield Outcome("worst", verdict(*(p == UC_DP for p in worst.values())), values)
    better = [
        found[slc].distance.mean() < found[uc].distance.mean()
        for found in by_length.values()
        for uc, slc in ((UC_DP, SLC_DP), (UC_CP, SLC_CP), (UC_SLP, SLC_SLP))
    ]
    rest, went = (found[SLC_SLP].distance.mean() for found in (long, moving))
    values = {"better": sum(better), "count": len(better), "rest": rest, "moving": went}
    yield Outcome("better", verdict(all(better), sum(better) > 3), values)
    ends = {p: t.missed.mean() for p, t in long.items() if p in (*PRINTED, VARIABLE)}
    others = [end for p, end in ends.items() if p not in (SLC_SLP, VARIABLE, SLC_CP)]
    values = {
        "ends": ", ".join(f"{p.name} {1e3 * end:.0f} mm" for p, end in ends.items()),
        "from_zero": pair_numbers(long, FROM_ZERO),
        "zero": long[FROM_ZERO].turned.mean(),
        "variable": long[VARIABLE].turned.mean(),
    }
    agrees = verdict(ends[SLC_SLP] < min(others), ends[VARIABLE] < ends[SLC_SLP])
    yield Outcome("final", agrees, values)

    found = results.tracked[SHOWN]
    uc, slc = EXCHANGED
    values = {
        f"{whose}_{name}": getattr(found[pair], name).mean()
        for whose, pair in (("own", SLC_SLP), ("other", slc))
        for name in ("distance", "missed", "turned")
    }
    values |= {"uc_other": found[uc].distance.mean(), "uc_own": found[UC_SLP].distance.mean()}
    yield Outcome("frames", verdict(values["own_missed"] >= values["other_missed"]), values)
    by_moving = {n: results.tracked[setup] for n, setup in MOVING.items()}
    text = "; ".join(
        f"{n:g} m: {pair_numbers(f, UC_SLP, SLC_SLP, VARIABLE)}" for n, f in by_moving.items()
    )
    agrees = verdict(*(f[SLC_SLP].distance.mean() <= 0.015 for f in by_moving.values()))
    yield Outcome("moving", agrees, {"lengths": text, "rest": pair_numbers(found, *REST)})


def reasons_of(by_length: dict[float, dict[Pair, Tracked]]) -> dict[Pair, str]:
    """Why the lines of Table 4 come out as they do."""
    long = by_length[LENGTHS[-1]]
    uc, slc = (
        "; ".join(f"{n:g} m: {pair_numbers(found, p)}" for n, found in by_length.items())
        for p in AS_CODED
    )
    return {
        UC_DP: "radius 0.106 m, at the limit of the sprockets. It hangs on the radius: "
        f"{pair_numbers(long, TIGHT[0], WIDE[0])} (0.7 m)",
        SLC_DP: f"likewise: {pair_numbers(long, TIGHT[1], WIDE[1])} (0.7 m)",
        UC_CP: "0.5 m is the contact length of the authors' sweep for mu = 0.4",
        SLC_CP: f"with either length; of variable speed: {pair_numbers(long, VARIABLE)} (0.7 m)",
        UC_SLP: f"plans that add beta, as in the code: {uc}",
        SLC_SLP: f"plans that add beta, and their body as in the code: {slc}",
    }


def model_claims(results: Planning) -> Iterator[Outcome]:
    """Sign of beta, 7.2.2, 7.2.3 and Table 5."""
    missed = {name: distances.mean() for name, distances in results.replays.items()}
    agrees = "no" if missed["added"] > missed["none"] else "yes"
    yield Outcome("sign", agrees, {**missed, "largest": results.replays["added"].max()})
    taken = {
        sign: [results.levels[sign, level].duration for level in PRINTED_LEVELS]
        for sign in ("subtracted", "added")
    }
    falls = [times == sorted(times, reverse=True) for times in taken.values()]
    signs = "; ".join(
        f"beta {sign}: {' / '.join(f'{t:.2f}' for t in times)} s" for sign, times in taken.items()
    )
    straight = math.hypot(2.0, 2.5) / 0.8
    yield Outcome("levels", verdict(*falls), {"signs": signs, "straight": straight})
    soils = results.soils
    times = [one.duration for one in soils.values()]
    bends = [float(np.abs(one.course_rate / one.speed).max()) for one in soils.values()]
    values: dict[str, Any] = {
        "frictions": ", ".join(f"{mu:g}" for mu in soils),
        "times": " / ".join(f"{t:.2f}" for t in times),
        "bends": " / ".join(f"{k:.1f}" for k in bends),
        "lower": "comes out" if bends[-1] < bends[0] else "does not come out",
    }
    yield Outcome("soils", "no" if times == sorted(times) else "yes", values)
    spent = {name: one.median for name, one in results.seconds.items()}
    values = {
        "fitted": 1e3 * spent["optimal, (54)"],
        "table": 1e3 * spent["optimal"],
        "exponential": missed["exponential"],
        "missed": missed["table"],
    }
    faster = spent["optimal, (54)"] < 0.5 * spent["optimal"]
    agrees = verdict(missed["exponential"] > 2.0 * missed["table"], faster)
    yield Outcome("cost_of_trees", agrees, values)
    text = ", ".join(f"{name} {1e3 * median:.2f} ms" for name, median in spent.items())
    values = {"seconds": text, "goals": len(results.dubins), "machine": results.machine}
    yield Outcome("seconds", "-", values)


def control_and_planning(results: Any) -> Iterator[Outcome]:
    """All of sections 4 to 7, in the order of the paper."""
    yield from identification_claims(results.identification)
    yield from spiral_claims(results.spiral)
    yield from chicane_claims(results)
    for part in (path_claims, tracking_claims, model_claims):
        yield from part(results.planning)
