"""What comes out of the claims of sections 4 to 8: every number is computed from the runs, and so
is every verdict. The words stand in page.toml.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from baselines.slip.slip_regression import Scores
from reproduce import Outcome, verdict
from reproduce.focchi2025 import control, slopes
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025 import planning_loop as loop
from reproduce.focchi2025.control import LENGTHS, RESISTANCE, Case, Numbers, vehicle
from reproduce.focchi2025.load_models import LOADS
from reproduce.focchi2025.planning import PRINTED_LEVELS
from reproduce.focchi2025.planning_loop import PRINTED, VARIABLE, Pair, Planning, Tracked
from reproduce.focchi2025.slopes import GRADES, SlopeCase, Slopes, Tracking
from reproduce.policy_runs import Drive, Floats
from tracked_env.physics.terramechanics import GRAVITY

SHORT, LONG = LENGTHS
RATE = control.RATES[0]  # [Hz] of the paper's simulation
REAL = (0.91, 0.84, 0.961)  # R^2 of F for the real vehicle: beta_left, beta_right, alpha
SIMILAR = 1.2  # [-] ratio of sizes that are "very similar", or of errors that hardly differ
GOAL = 0.20  # [-] largest loss of accuracy that a wrong assumed friction may leave
TURNS = (slice(2.5, 12.0), slice(13.0, 20.0))  # [s] of the chicane, without its jumps

UC_DP, SLC_DP, UC_CP, SLC_CP, UC_SLP, SLC_SLP = PRINTED
# Table 4 of F: e_xy [m] and e_phi [rad], mean and standard deviation of 100 goals.
TABLE_4 = {
    UC_DP: ((0.20, 0.096), (0.24, 0.089)),
    SLC_DP: ((0.089, 0.062), (0.40, 0.12)),
    UC_CP: ((0.090, 0.054), (0.056, 0.044)),
    SLC_CP: ((0.03, 0.022), (0.038, 0.046)),
    UC_SLP: ((0.11, 0.046), (0.18, 0.062)),
    SLC_SLP: ((0.055, 0.04), (0.14, 0.043)),
}
CLOTHOID_LONGER, OPTIMAL_LONGER, FAILED = 1.83, 1.31, 22  # Table 4: T over Dubins, plans
DURATIONS = {"dubins": 8.12, "clothoid": 9.07, "optimal, variable": 8.4}  # [s] 7.2, figure 16
PRINTED_GAP, PRINTED_LENGTH = 4.0, 15.6  # [m] F 8.1
PRINTED_COST = 11.0 / 0.49  # [-] nonuniform over uniform load
PRINTED_UC = (0.20, 0.20)  # [m] F 8.3: mean and final error of the unicycle controller
PRINTED_SLC = (0.059, 0.056)
PRINTED_PITCH = (-0.1, 0.2)  # [rad]


def three(scores: Scores) -> str:
    """R^2 of beta_left, beta_right and alpha forward."""
    return " / ".join(f"{value:.4g}" for value in scores[:3])


def of_trees(one: ident.Identified) -> dict[str, str]:
    """R^2 of decision trees."""
    return {"held_out": three(one.held_out), "unseen": three(one.unseen)}


def identification_claims(results: ident.Identifications) -> Iterator[Outcome]:
    """Section 4 and 7.2.3."""
    simulated, real = results.simulated, results.measured
    low, middle, high = (results.by_friction[mu] for mu in ident.FRICTIONS)
    agrees = verdict(*(min(one[:3]) > 0.999 for one in (simulated.held_out, simulated.unseen)))
    yield Outcome("simulated", agrees, {**of_trees(simulated), "runs": len(low.v_x)})
    brief = results.brief
    agrees = verdict(brief.determination[0] > 0.98, brief.determination[2] > 0.98)
    yield Outcome("two_seconds", agrees, {"brief": brief, "slow": results.brief_slow})
    if real is not None:
        near = [abs(a - b) < 0.05 for a, b in zip(real.unseen[:3], REAL, strict=True)]
        yield Outcome("real", verdict(*near), of_trees(real))
        rows = [
            {"n": n, "correlation": one.correlation[:2].min(), "slope": one.slope[:2]}
            for n, one in results.against_measured.items()
        ]
        agrees = verdict(*(abs(row["slope"].mean() - 1.0) < 0.3 for row in rows))
        yield Outcome("beta", agrees, {"rows": rows})
        behind, moved = results.behind[LONG]
        values = {"behind": behind, "moved": moved, "each": results.behind_each}
        yield Outcome("alpha", "yes", {"alpha": results.against_measured[LONG], **values})
    at_low, at_middle = ident.share_above(low, middle), ident.share_above(middle, high)
    agrees = verdict(at_low > 1.5, at_middle < SIMILAR)
    yield Outcome("friction", agrees, {"low": at_low, "middle": at_middle})


def spiral_claims(spirals: dict[str, control.Spiral]) -> Iterator[Outcome]:
    """Figure 10."""
    uc, slc = spirals["uc"], spirals["slc"]
    yield Outcome("spiral", "-", {"beyond": control.beyond_after(vehicle())})
    half = len(uc.value) // 2
    late = {kind: float(one.run.distance[half:].max()) for kind, one in spirals.items()}
    end = {kind: one.run.distance[-1, 0] for kind, one in spirals.items()}
    yield Outcome("converges", verdict(late["slc"] < 0.5 * late["uc"]), {"late": late, "end": end})
    numbers = {"uc": uc, "slc": slc, "last": slc.value[-1], "period": 1e3 / control.SPIRAL_RATE}
    yield Outcome("lyapunov", verdict(slc.rises < 1e-3), numbers)


def prediction(
    runs: dict[Case, Drive], predicted: dict[Case, tuple[Floats, Floats, Floats]], case: Case
) -> dict[str, tuple[float, float, float]]:
    """Figure 14: {channel: (rms actual, rms error in the turns, rms error within 1 s of jumps)}."""
    run = runs[case]
    actual = control.slip_of(run, vehicle(case.length, case.friction, case.resistance))
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
    numbers = {case: control.numbers(run) for case, run in results.chicane.items()}
    paper = {(kind, n): numbers[Case(kind, n, RATE)] for kind in control.KINDS for n in LENGTHS}
    ramps = {
        "plain": results.readings["v_max t / t_1", SHORT, 0.0, "uc"],
        "ramp": [results.readings["v_max t / t_1", n, RESISTANCE, "table"] for n in LENGTHS],
        "begun": control.BEGUN,
        "leaves": 1.0 / control.SPEED**2,
    }
    uc, slc = ([paper[kind, n] for n in LENGTHS] for kind in control.KINDS)
    agrees = verdict(*(abs(one.largest - 0.1) < 0.03 for one in uc))
    yield Outcome("uc", agrees, {"short": uc[0], "long": uc[1], **ramps})
    agrees = verdict(*(one.largest < 0.03 for one in slc))
    yield Outcome("slc", agrees, {"short": slc[0], "long": slc[1], **ramps})
    rows = [{"n": n, "uc": uc[i], "slc": slc[i]} for i, n in enumerate(LENGTHS)]
    better = (a.heading / b.heading > SIMILAR for a, b in zip(uc, slc, strict=True))
    agrees = verdict(*better)
    yield Outcome("orientation", agrees, {"rows": rows})
    case = Case("table", LONG, RATE)
    slip = prediction(results.chicane, results.predicted, case)
    share = [error / size for size, error, _ in slip.values()]
    jump = min(slip[name][2] / slip[name][1] for name in ("beta_left", "beta_right"))
    agrees = verdict(max(share[:2]) < 0.2, jump > 2.0, share[2] < 0.2)
    end = results.chicane[case].time[-1]
    yield Outcome("predicted", agrees, {"share": share, "jump": jump, "rate": RATE, "end": end})
    yield from further_claims(results, numbers)


def further_claims(results: Any, numbers: dict[Case, Numbers]) -> Iterator[Outcome]:
    """Comparisons that the paper leaves open or does not make."""

    def largest(kind: str, length: float, **other: Any) -> float:
        return numbers[Case(kind, length, **other)].largest

    kinds = ("exponential", "exponential, slow", "uc", "table")
    rows: list[Any] = [{"n": n, "largest": [largest(kind, n) for kind in kinds]} for n in LENGTHS]
    agrees = verdict(*(one < row["largest"][2] for row in rows for one in row["largest"][:2]))
    scores = three(results.identification.simulated.exponential_fit)
    yield Outcome("exponential", agrees, {"scores": scores, "rows": rows})

    loss, wrong = [], []
    for length in LENGTHS:
        for true, assumed in control.SOILS:
            right, guess, online = (
                numbers[Case(kind, length, friction=true, assumed=friction)]
                for kind, friction in (("table", true), ("table", assumed), ("online", assumed))
            )
            loss += [online.largest / right.largest - 1.0, online.rmse / right.rmse - 1.0]
            wrong.append(guess.largest / right.largest)
    values: dict[str, Any] = {"loss": max(loss), "least": min(wrong), "most": max(wrong)}
    yield Outcome("online", verdict(max(loss) < GOAL), values)

    by_rate = [
        [largest(kind, n, rate=rate) for rate in control.RATES]
        for kind in control.KINDS
        for n in LENGTHS
    ]
    ratios = [max(errors) / min(errors) for errors in by_rate]
    yield Outcome("rates", verdict(max(ratios) < 1.1), {"apart": max(ratios) - 1})
    free = {"resistance": 0.0, "assumed_resistance": 0.0}
    rows = [
        {"n": n, **{k: (largest(k, n), largest(k, n, **free)) for k in control.KINDS}}
        for n in LENGTHS
    ]
    yield Outcome("rolling", "-", {"rows": rows})
    apart = max(
        abs(one.largest - results.integrators["Rosenbrock, 1 ms", kind].largest)
        for (_, kind), one in results.integrators.items()
    )
    yield Outcome("integration", verdict(apart < 1e-3), {"apart": apart})


# Sections 6 and 7.2


def pair_numbers(tracked: Mapping[Pair, Tracked], *pairs: Pair) -> str:
    """Mean e_xy [m] and e_phi [rad] of pairs."""
    means = ((p.name, tracked[p].distance.mean(), tracked[p].heading.mean()) for p in pairs)
    return ", ".join(f"{name} {distance:.3f} / {heading:.3f}" for name, distance, heading in means)


def by_lengths(by_length: Mapping[float, Mapping[Pair, Tracked]], *pairs: Pair) -> str:
    """The same for every contact length."""
    return "; ".join(f"{n:g} m: {pair_numbers(one, *pairs)}" for n, one in by_length.items())


def near(ours: float, printed: tuple[float, float]) -> bool:
    """Whether a mean is within half a printed standard deviation of the printed one."""
    return abs(ours - printed[0]) <= 0.5 * printed[1]


def path_claims(results: Planning) -> Iterator[Outcome]:
    """Durations: figure 16 and Table 4."""
    durations = {pair.planner: job.trajectory.duration for pair, (job, _) in results.shown.items()}
    values: dict[str, Any] = {
        "durations": [durations[name] for name in DURATIONS],
        "constant": durations["optimal"],
        "results": results,
    }
    agrees = verdict(*(abs(durations[name] - t) < 0.05 for name, t in DURATIONS.items()))
    yield Outcome("durations", agrees, values)
    ratios = results.ratios
    agrees = verdict(abs(ratios[1.0] - CLOTHOID_LONGER) < 0.02)
    values = {"near": ratios[1.0], "far": ratios[2.0], "nearer": results.nearer}
    yield Outcome("clothoids", agrees, values)
    optimal = results.tracked[loop.PAPER[LONG]][SLC_SLP].duration
    longer = float(optimal.mean() / results.dubins.mean())
    unwrapped, converged = results.unwrapped, results.unwrapped.converged
    ratio = float(unwrapped.duration[converged].mean() / results.dubins[converged].mean())
    agrees = verdict(*(abs(each - OPTIMAL_LONGER) < 0.03 for each in (longer, ratio)))
    turns = int(np.sum(unwrapped.turns != 0.0))
    yield Outcome("longer", agrees, {"longer": longer, "ratio": ratio, "turns": turns})
    failed = len(converged) - int(converged.sum())
    yield Outcome("failed", verdict(failed >= FAILED), {"failed": failed, "plans": len(converged)})


def tracking_claims(results: Planning) -> Iterator[Outcome]:
    """Table 4 and figure 17."""
    by_length = {length: results.tracked[setup] for length, setup in loop.PAPER.items()}
    reasons = reasons_of(by_length)
    for pair, printed in TABLE_4.items():
        rows: list[dict[str, Any]] = [
            {
                "n": n,
                "means": [errors.mean() for errors in tracked[pair][:2]],
                "spreads": [errors.std() for errors in tracked[pair][:2]],
            }
            for n, tracked in by_length.items()
        ]
        agrees = verdict(*(any(near(r["means"][k], printed[k]) for r in rows) for k in (0, 1)))
        values: dict[str, Any] = {"name": pair.name, "distance": printed[0], "heading": printed[1]}
        yield Outcome("pair", agrees, {**values, "rows": rows, "reason": reasons[pair]})

    long, moving = by_length[LONG], results.tracked[loop.MOVING[LONG]]
    worst = {n: max(PRINTED, key=lambda p: t[p].distance.mean()) for n, t in by_length.items()}
    values = {
        "worst": "; ".join(f"{n:g} m: {p.name}" for n, p in worst.items()),
        "radii": pair_numbers(long, *loop.TIGHT, *loop.WIDE),
        "saturated": long[UC_DP].saturated.mean(),
    }
    yield Outcome("worst", verdict(*(p == UC_DP for p in worst.values())), values)
    better = [
        tracked[slc].distance.mean() < tracked[uc].distance.mean()
        for tracked in by_length.values()
        for uc, slc in zip(PRINTED[::2], PRINTED[1::2], strict=True)
    ]
    rest, went = (tracked[SLC_SLP].distance.mean() for tracked in (long, moving))
    values = {"better": sum(better), "count": len(better), "rest": rest, "moving": went}
    yield Outcome("better", verdict(all(better), sum(better) > 3), values)
    ends = {p: t.missed.mean() for p, t in long.items() if p in (*PRINTED, VARIABLE)}
    others = [end for p, end in ends.items() if p not in (SLC_SLP, VARIABLE)]
    values = {
        "ends": ", ".join(f"{p.name} {1e3 * end:.0f} mm" for p, end in ends.items()),
        "from_zero": pair_numbers(long, loop.FROM_ZERO),
        "zero": long[loop.FROM_ZERO].turned.mean(),
        "variable": long[VARIABLE].turned.mean(),
    }
    agrees = verdict(ends[SLC_SLP] < min(others), ends[VARIABLE] < ends[SLC_SLP])
    yield Outcome("final", agrees, values)

    uc, slc = loop.EXCHANGED
    frames: dict[str, Any] = {
        name: {field: getattr(long[pair], field).mean() for field in Tracked._fields}
        for name, pair in (("own", SLC_SLP), ("other", slc), ("uc_own", UC_SLP), ("uc_other", uc))
    }
    yield Outcome("frames", verdict(frames["own"]["missed"] >= frames["other"]["missed"]), frames)
    by_moving = {n: results.tracked[setup] for n, setup in loop.MOVING.items()}
    agrees = verdict(*(t[SLC_SLP].distance.mean() <= 0.015 for t in by_moving.values()))
    text = by_lengths(by_moving, UC_SLP, SLC_SLP, VARIABLE)
    yield Outcome("moving", agrees, {"lengths": text, "rest": pair_numbers(long, *loop.REST)})


def reasons_of(by_length: dict[float, dict[Pair, Tracked]]) -> dict[Pair, str]:
    """Why the lines of Table 4 come out as they do."""
    long, (tight, wide) = by_length[LONG], (loop.TIGHT, loop.WIDE)
    uc, slc = (by_lengths(by_length, pair) for pair in loop.AS_CODED)
    return {
        UC_DP: "radius 0.106 m, at the limit of the sprockets. It hangs on the radius: "
        f"{pair_numbers(long, tight[0], wide[0])} (0.7 m)",
        SLC_DP: f"likewise: {pair_numbers(long, tight[1], wide[1])} (0.7 m)",
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
    rows: list[dict[str, Any]] = [
        {"sign": sign, "times": [results.levels[sign, level].duration for level in PRINTED_LEVELS]}
        for sign in ("subtracted", "added")
    ]
    falls = [row["times"] == sorted(row["times"], reverse=True) for row in rows]
    yield Outcome("levels", verdict(*falls), {"rows": rows, "straight": math.hypot(2.0, 2.5) / 0.8})
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
    fitted, table = spent["optimal, (54)"], spent["optimal"]
    agrees = verdict(missed["exponential"] > 2.0 * missed["table"], fitted < 0.5 * table)
    yield Outcome("cost_of_trees", agrees, {"fitted": fitted, "table": table, "missed": missed})
    text = ", ".join(f"{name} {1e3 * median:.2f} ms" for name, median in spent.items())
    values = {"seconds": text, "goals": len(results.dubins), "machine": results.machine}
    yield Outcome("seconds", "-", values)


# Sections 4.5 and 8


def slope_claims(results: Slopes) -> Iterator[Outcome]:
    """Section 4.5."""
    slip = results.identification
    fine, level = slip.scores["steps of 0.05"], slip.scores["level ground"]
    names = "fine", "coarse", "uniform", "level"  # of the models, in their order
    values: dict[str, Any] = {
        name: " / ".join(f"{one:.4f}" for one in scores)
        for name, scores in zip(names, slip.scores.values(), strict=True)
    }
    values |= {"steady": slip.steady, "steepest": slopes.STEEPEST, "fastest": slopes.FASTEST}
    values["friction"] = loads.FRICTION
    yield Outcome("gravity", verdict(float(fine.min()) > 0.99, float(level.min()) < 0.7), values)
    yield Outcome("ramps", "no", values)
    up, flat, down = slip.bend
    values = {"up": up, "flat": flat, "down": down, "bend": slopes.BEND, "share": 1.0 - slip.uphill}
    yield Outcome("downhill", verdict(slip.uphill < 0.2), values)
    ratio = slip.side_slip / GRADES
    growth = ratio[1] / ratio[1, 0]
    middle = int(np.argmin(np.abs(GRADES - 0.2)))
    agrees = verdict(abs(growth[middle] - 1.0) < 0.1, abs(growth[-1] - 1.0) < 0.1)
    sizes = {"middle": growth[middle], "most": growth[-1], "size": abs(slip.side_slip[1, -1])}
    yield Outcome("proportional", agrees, {**sizes, "first": GRADES[0], "last": GRADES[-1]})
    agrees = verdict(*(abs(one[0] / flat[0] - 1.0) > 0.02 for one in (up, down)))
    yield Outcome("rotation", agrees, values)


def load_claims(results: Slopes) -> Iterator[Outcome]:
    """Sections 2.2.2 and 8.1."""
    first, scripted = results.grounds[0], ""
    if results.scripted:
        apart = {
            soil: loads.gap(*(results.scripted[soil, load] for load in LOADS))[0]
            for soil in loads.SOILS
        }
        scripted = (
            f"; from (19, 3), where their test on slopes starts: {apart['Table 2']:.1f} m, and "
            f"{apart['authors']:.2f} m on the ground of that test"
        )
    for ground in results.grounds:
        rows, agreed = [], []
        for commands in loads.COMMANDS:
            runs = [results.open_loop[ground.name, commands, load] for load in LOADS]
            gaps, lengths = loads.gap(*runs), loads.length(runs[0])
            rows += [
                {"commands": commands, "h": h, "gap": gap, "length": length, "share": gap / length}
                for h, gap, length in zip(loads.HEADINGS, gaps, lengths, strict=True)
            ]
            close = abs(gaps[0] - PRINTED_GAP) < 0.5 and abs(lengths[0] - PRINTED_LENGTH) < 0.1
            agreed.append(bool(close))
        spread = results.spread[ground.name]
        values = {
            "ground": ground.name,
            "rows": rows,
            "scripted": scripted,
            "starts": slopes.STARTS,
            "median": np.median(spread),
            "high": np.percentile(spread, 90),
        }
        of_paper = ground is first and not results.missing
        yield Outcome("loads", verdict(*agreed) if of_paper else "-", values)
    printed, table = results.decay["as 8.1 prints"], results.decay["Table 2"]
    yield Outcome("damping", verdict(printed[0] < 2000.0), {"printed": printed, "table": table})
    plant, expected = results.side
    values = {"slope": slopes.SIDE_SLOPE, "plant": plant, "expected": expected}
    yield Outcome("side", verdict(plant > 0.0, plant < 0.0), values)
    hilly = float(results.open_loop[first.name, "(53)", "nonuniform"].balance[:, 0].std())
    level = float(results.level.balance.std())
    turn = 2.0 * loads.SPEED * loads.TURN * loads.HEIGHT / (GRAVITY * 0.606)
    values = {"hilly": hilly, "level": level, "ground": first.name, "turn": turn}
    yield Outcome("dominates", verdict(hilly > 2.0 * level), values)
    ratio = results.cost["nonuniform"] / results.cost["uniform"]
    values = {**results.cost, "ratio": ratio, "printed": PRINTED_COST, "ground": first.name}
    yield Outcome("cost", "-", values)


def stiffening_claims(results: Slopes) -> Iterator[Outcome]:
    """Section 8.2."""
    runs = results.stiffening
    rows: list[dict[str, Any]] = []
    for name, pair in loads.PAIRS.items():
        formula, largest = loads.foremost(*pair, loads.TOP_SPEED), runs[name, "as coded"].stiffness
        off = abs(formula / loads.PRINTED_STIFFNESS - 1.0)
        rows.append({"pair": pair, "formula": formula, "largest": float(largest.max()), "off": off})
    agrees = verdict(*(row["off"] < 0.02 for row in rows))
    yield Outcome("stiffness", agrees, {"rows": rows, "off": [row["off"] for row in rows]})
    soft, coded = runs["fits", "per track"], runs["fits", "as coded"]
    values = {
        "most": -coded.pitch.min(),
        "coded": coded,
        "softer": loads.PER_AREA["as coded"] / loads.PER_AREA["per track"],
        "soft": -soft.pitch.min(),
        "leaves": "the foremost patches leave the ground and " if soft.raised else "and ",
        "largest": float(soft.stiffness.max()),
    }
    yield Outcome("pitches", verdict(coded.pitch.min() < -0.01, coded.held < 0.0), values)


def both(one: Tracking) -> str:
    """Mean and final error in cm."""
    return f"{100.0 * one.mean:.1f} / {100.0 * one.final:.1f} cm"


def close_to(one: Tracking, printed: tuple[float, float]) -> list[bool]:
    """Whether mean and final error are within a quarter of the printed ones."""
    return [abs(ours / theirs - 1.0) < 0.25 for ours, theirs in zip(one[:2], printed, strict=True)]


def slope_tracking_claims(results: Slopes) -> Iterator[Outcome]:
    """Section 8.3."""
    numbers = {case: slopes.tracking(run) for case, run in results.closed_loop.items()}
    kinds, heading = slopes.KINDS, slopes.HEADINGS[1]
    for ground in results.grounds:
        of_paper = ground is results.grounds[0] and not results.missing
        ours = {kind: numbers[SlopeCase(ground.name, kind)] for kind in kinds}
        turned = [numbers[SlopeCase(ground.name, kind, heading=heading)] for kind in kinds]
        values: dict[str, Any] = {kind: both(one) for kind, one in ours.items()}
        values |= {"ground": ground.name, "heading": heading}
        values["turned"] = ", ".join(map(both, turned))
        agrees = verdict(*close_to(ours["uc"], PRINTED_UC))
        yield Outcome("slope_uc", agrees if of_paper else "-", values)
        agrees = verdict(*(all(close_to(ours[k], PRINTED_SLC)) for k in ("slope", "uniform")))
        yield Outcome("slope_slc", agrees if of_paper else "-", values)
    name = results.grounds[0].name
    rows = [numbers[SlopeCase(name, kind)] for kind in kinds]
    uniform = [numbers[SlopeCase(name, kind, "uniform")] for kind in kinds[:3]]
    values = {
        "ground": name,
        "nonuniform": rows[0].mean / rows[2].mean,
        "other": rows[0].mean / rows[3].mean,
        "uniform": uniform[0].mean / uniform[2].mean,
        "loads": ", ".join(map(both, uniform)),
        "short": both(numbers[SlopeCase(name, "uc", length=SHORT)]),
    }
    ratio, printed = values["nonuniform"], PRINTED_UC[0] / PRINTED_SLC[0]
    yield Outcome("slope_ratio", verdict(ratio > 1.0, abs(ratio / printed - 1.0) < 0.25), values)
    pitch = rows[2].pitch
    agrees = verdict(*(abs(a - b) < 0.05 for a, b in zip(pitch, PRINTED_PITCH, strict=True)))
    agrees = "-" if results.missing else agrees
    yield Outcome("slope_pitch", agrees, {"ground": name, "pitch": pitch})


def outcomes(results: Any) -> Iterator[Outcome]:
    """All, in the order of the paper."""
    yield from identification_claims(results.identification)
    yield from spiral_claims(results.spiral)
    yield from chicane_claims(results)
    for claims in (path_claims, tracking_claims, model_claims):
        yield from claims(results.planning)
    for part in (slope_claims, load_claims, stiffening_claims, slope_tracking_claims):
        yield from part(results.slopes)
