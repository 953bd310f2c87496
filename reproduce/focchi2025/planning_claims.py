"""What the paper claims in sections 6 and 7.2, what comes out, and whether the two agree."""

import math

import numpy as np

from reproduce.focchi2025.planning_as_coded import PRINTED_LEVELS
from reproduce.focchi2025.planning_loop import (
    AS_CODED,
    EXCHANGED,
    FROM_ZERO,
    PRINTED,
    REST,
    TIGHT,
    VARIABLE,
    WIDE,
    Pair,
)
from reproduce.focchi2025.planning_loop import Tracked as Errors
from reproduce.focchi2025.planning_runs import MOVING, PAPER, SHOWN, Planning
from reproduce.focchi2025.runs import LENGTHS
from reproduce.paper_page import Claim, verdict

UC_DP, SLC_DP, UC_CP, SLC_CP, UC_SLP, SLC_SLP = PRINTED
# Table 4 of F: e_xy [m] and e_phi [rad], mean and standard deviation of 100 goals.
TABLE_4 = {
    UC_DP: ((0.20, 0.096), (0.24, 0.089)), SLC_DP: ((0.089, 0.062), (0.40, 0.12)),
    UC_CP: ((0.090, 0.054), (0.056, 0.044)), SLC_CP: ((0.03, 0.022), (0.038, 0.046)),
    UC_SLP: ((0.11, 0.046), (0.18, 0.062)), SLC_SLP: ((0.055, 0.04), (0.14, 0.043)),
}  # fmt: skip
CLOTHOID_LONGER, OPTIMAL_LONGER, FAILED = 1.83, 1.31, 22  # Table 4: T over Dubins, plans
FIGURE_16_DURATIONS = {"dubins": 8.12, "clothoid": 9.07, "optimal, from 0": 8.4}  # [s] 7.2
TABLE_5 = {
    "dubins": 0.06, "clothoid": 0.022, "optimal, (54)": 1.64, "optimal": 18.0,
}  # [s] of F, with its decision trees for "optimal"  # fmt: skip


def pair_numbers(found: dict[Pair, Errors], *pairs: Pair) -> str:
    """Mean e_xy [m] and e_phi [rad] of pairs."""
    return ", ".join(
        f"{p.name} {found[p].distance.mean():.3f} / {found[p].heading.mean():.3f}" for p in pairs
    )


def near(ours: float, printed: tuple[float, float]) -> bool:
    """Whether a mean is within half a printed standard deviation of the printed one."""
    return abs(ours - printed[0]) <= 0.5 * printed[1]


def path_claims(results: Planning) -> list[Claim]:
    """Durations: figure 16 and Table 4."""
    by_planner = {pair.planner: job.trajectory for pair, (job, _) in results.shown.items()}
    free = results.tracked[PAPER[LENGTHS[-1]]]
    shown = {
        "dubins": by_planner["dubins"].duration, "clothoid": by_planner["clothoid"].duration,
        "optimal, from 0": by_planner[VARIABLE.planner].duration,
    }  # fmt: skip
    longer = float(free[SLC_SLP].duration.mean() / results.dubins.mean())
    wound = results.unwrapped
    kept = wound.converged
    ratio = float(wound.duration[kept].mean() / results.dubins[kept].mean())
    failed = len(kept) - int(kept.sum())
    return [
        Claim("7.2, fig. 16", "goal (2, 2.5, -0.4): Dubins 8.12 s, clothoid 9.07 s, SLP of "
              "variable speed 8.4 s", " / ".join(f"{value:.3f}" for value in shown.values()) + " s",
              verdict(*(abs(shown[n] - t) < 0.05 for n, t in FIGURE_16_DURATIONS.items())),
              f"0.7 m, mu = 0.4; at constant speed SLP takes {by_planner['optimal'].duration:.3f} "
              f"s as well: the vehicle is fastest at v_max. A plan that adds beta takes "
              f"{results.added:.2f} s, less than the optimum without slip, {results.unslipped:.2f} "
              "s"),
        Claim("7.2.1, Table 4", "clothoids take 83 % longer than Dubins paths",
              f"{results.ratios[1.0]:.3f} times",
              verdict(abs(results.ratios[1.0] - CLOTHOID_LONGER) < 0.02),
              "ratio of means, 100 Halton points from 1 to 4 m away as in the code; with the "
              f"annulus as printed, from 2 m, {results.ratios[2.0]:.3f}; "
              f"{results.nearer} of the hundred are nearer than 2 m"),
        Claim("7.2.1, Table 4", "optimal plans take 31 % longer than Dubins paths",
              f"{longer:.3f} times; with the yaw of the goal in [0, 2 pi) as it stands, as in the "
              f"code, {ratio:.2f}", verdict(abs(longer - OPTIMAL_LONGER) < 0.03,
                                            abs(ratio - OPTIMAL_LONGER) < 0.03),
              f"(52) compares yaws without wrapping: {int(np.sum(wound.turns != 0.0))} plans must "
              "wind a whole turn more than the shortest path does"),
        Claim("7.2.1, Table 4", "22 of 100 optimal plans do not converge",
              f"none fails; with the yaw as it stands {failed} of {len(kept)}",
              verdict(failed >= FAILED),
              "so it is not the problem. A hypothesis: fmincon ends after 5000 evaluations by "
              "finite differences of decision trees, whose gradient is zero almost everywhere"),
    ]  # fmt: skip


def tracking_claims(results: Planning) -> list[Claim]:
    """Table 4 and figure 17."""
    made = []
    by_length = {length: results.tracked[setup] for length, setup in PAPER.items()}
    for pair, (distance, heading) in TABLE_4.items():
        ours = {n: found[pair] for n, found in by_length.items()}
        made.append(
            Claim("7.2.1, Table 4",
                  f"{pair.name}: {distance[0]:g} ± {distance[1]:g} m, {heading[0]:g} ± "
                  f"{heading[1]:g} rad",
                  "; ".join(f"{n:g} m: {t.distance.mean():.3f} ± {t.distance.std():.3f} m, "
                            f"{t.heading.mean():.3f} ± {t.heading.std():.3f} rad"
                            for n, t in ours.items()),
                  verdict(any(near(t.distance.mean(), distance) for t in ours.values()),
                          any(near(t.heading.mean(), heading) for t in ours.values())),
                  reason(pair, by_length))
        )  # fmt: skip
    long = by_length[LENGTHS[-1]]
    moving = results.tracked[MOVING[LENGTHS[-1]]]
    worst = {n: max(PRINTED, key=lambda p: f[p].distance.mean()) for n, f in by_length.items()}
    better = [
        f[slc].distance.mean() < f[uc].distance.mean()
        for f in by_length.values()
        for uc, slc in ((UC_DP, SLC_DP), (UC_CP, SLC_CP), (UC_SLP, SLC_SLP))
    ]
    ends = {p: t.missed.mean() for p, t in long.items() if p in (*PRINTED, VARIABLE)}
    made += [
        Claim("7.2.1, Table 4", "the worst result is UC-DP",
              "; ".join(f"{n:g} m: {p.name}" for n, p in worst.items())
              + f"; 0.7 m, Dubins paths of other radii: {pair_numbers(long, *TIGHT, *WIDE)}",
              verdict(*(p == UC_DP for p in worst.values())),
              "it depends on the radius: paths at the limit of the sprockets saturate them in "
              f"{100 * long[UC_DP].saturated.mean():.0f} % of the time, and what is saturated no "
              "controller tracks"),
        Claim("7.2.1, fig. 17", "in all cases the slippage-aware controller is better than UC",
              f"{sum(better)} of {len(better)} comparisons of e_xy", verdict(all(better),
                                                                            sum(better) > 3),
              "not where the sprockets are saturated (Dubins at the limit); from rest most of the "
              "error of SLP is the start, which both share: SLC-SLP "
              f"{long[SLC_SLP].distance.mean():.3f} m, from a moving start "
              f"{moving[SLC_SLP].distance.mean():.3f} m"),
        Claim("7.2, fig. 17", "best final error: SLC-SLP, even better with variable speed",
              ", ".join(f"{p.name} {1e3 * e:.0f} mm" for p, e in ends.items()),
              verdict(ends[SLC_SLP] < min(e for p, e in ends.items()
                                          if p not in (SLC_SLP, VARIABLE, SLC_CP)),
                      ends[VARIABLE] < ends[SLC_SLP]),
              "mean distance to the goal, 0.7 m, 100 goals; v in [0.15, 0.4] m/s. "
              "SLC-CP ends nearer, after 1.84 times the time. With v_min = 0 as "
              f"printed: {pair_numbers(long, FROM_ZERO)}, yaw at the end "
              f"{long[FROM_ZERO].turned.mean():.3f} instead of {long[VARIABLE].turned.mean():.3f} "
              "rad: it turns on the spot"),
        hand_over_claim(results),
        moving_claim(results),
    ]  # fmt: skip
    return made


def reason(pair: Pair, by_length: dict[float, dict[Pair, Errors]]) -> str:
    """Why a line of Table 4 comes out as it does."""
    long = by_length[LENGTHS[-1]]
    uc, slc = AS_CODED
    coded = {
        p: "; ".join(f"{n:g} m: {pair_numbers(found, p)}" for n, found in by_length.items())
        for p in AS_CODED
    }
    return {
        UC_DP: "radius 0.106 m, at the limit of the sprockets. It hangs on the radius: "
        f"{pair_numbers(long, TIGHT[0], WIDE[0])} (0.7 m)",
        SLC_DP: f"likewise: {pair_numbers(long, TIGHT[1], WIDE[1])} (0.7 m)",
        UC_CP: "0.5 m is the contact length of the authors' sweep for mu = 0.4",
        SLC_CP: f"with either length; of variable speed: {pair_numbers(long, VARIABLE)} (0.7 m)",
        UC_SLP: f"plans that add beta, as in the code: {coded[uc]}",
        SLC_SLP: f"plans that add beta, and their body as in the code: {coded[slc]}",
    }[pair]


def hand_over_claim(results: Planning) -> Claim:
    """What the controllers are given of a plan."""
    found = results.tracked[SHOWN]
    uc, slc = EXCHANGED
    own, other = found[SLC_SLP], found[slc]
    return Claim(
        "7.2 (code)", "both controllers follow the pose of a plan, with its belt speeds",
        f"exchanged / own frame: e_xy {other.distance.mean():.3f} / {own.distance.mean():.3f} m, "
        f"at the goal {other.missed.mean():.3f} / {own.missed.mean():.3f} m, "
        f"{other.turned.mean():.2f} / {own.turned.mean():.2f} rad (SLC-SLP); UC-SLP on the course "
        f"{found[uc].distance.mean():.3f} / {found[UC_SLP].distance.mean():.3f} m",
        verdict(own.missed.mean() >= other.missed.mean()),
        "SLC adds beta and alpha to what it is given: with belt speeds slip counts twice. It needs "
        "the course yaw + alpha and the speed over the ground; UC the belts. 0.7 m, from rest",
    )  # fmt: skip


def moving_claim(results: Planning) -> Claim:
    """The same plans from a vehicle that moves already."""
    found = {n: results.tracked[setup] for n, setup in MOVING.items()}
    return Claim(
        "7.2.1", "(not in the paper) the vehicle moves already when the plan begins",
        "; ".join(f"{n:g} m: {pair_numbers(f, UC_SLP, SLC_SLP, VARIABLE)}"
                  for n, f in found.items()),
        verdict(*(f[SLC_SLP].distance.mean() <= 0.015 for f in found.values())),
        "goal: 0.015 m. Sprockets planned up to 90 %. From rest the plan asks for 0.4 m/s at once, "
        "and the lateral part of that error leaves in k_phi / v^2 = 6 s. Plans from rest to rest "
        f"with 5 rad/s^2, 0.7 m: {pair_numbers(results.tracked[SHOWN], *REST)}",
    )  # fmt: skip


def model_claims(results: Planning) -> list[Claim]:
    """Sign of beta, 7.2.2, 7.2.3 and Table 5."""
    r, levels = results.replays, results.levels
    taken = {sign: [levels[sign, level].duration for level in PRINTED_LEVELS]
             for sign in ("subtracted", "added")}  # fmt: skip
    falls = {sign: taken[sign] == sorted(taken[sign], reverse=True) for sign in taken}
    soil = [one.duration for one in results.soils.values()]
    spent = {n: results.seconds[n].median for n in TABLE_5}
    bend = [float(np.abs(one.course_rate / one.speed).max()) for one in results.soils.values()]
    straight = math.hypot(2.0, 2.5) / 0.8
    return [
        Claim("6.3, (29)", "the planner's forward map adds beta",
              f"at the end of such plans {r.added.mean():.2f} m from the goal (mean, largest "
              f"{r.added.max():.1f}); beta subtracted {r.table.mean():.3f} m; no slip known "
              f"{r.none.mean():.2f} m", "no" if r.added.mean() > r.none.mean() else "yes",
              "sprocket speeds replayed on the pseudo-kinematic model with the identified table, "
              "beta = r omega - v_track. With (29) as printed slip turns the vehicle more, and "
              "the plan is worse than one that ignores slip"),
        Claim("7.2.2, fig. 18", "5.2 / 4.9 / 4.12 s at normal / medium / high slip: the optimizer "
              "leverages slippage",
              "; ".join(f"beta {sign}: " + " / ".join(f"{t:.2f}" for t in times) + " s"
                        for sign, times in taken.items()),
              verdict(falls["subtracted"], falls["added"]),
              "constants of (54), c_1 times 1, 3, 4 and c_2 times 1, 0.5, 0.25 as in the code, "
              "which trains nothing. With beta added more slip turns the vehicle for nothing. The "
              "ground speed is at most v_max here, in the paper the belts' mean is: the "
              f"{straight:.2f} s of the straight line bound all of it. A run without that bound is "
              "not part of this"),
        Claim("7.2.2", "more slip makes the plan faster: the same goal with the slip identified at "
              "mu = " + ", ".join(f"{mu:g}" for mu in results.soils),
              " / ".join(f"{t:.2f}" for t in soil) + " s; largest curvature "
              + " / ".join(f"{k:.1f}" for k in bend) + " 1/m",
              "no" if soil == sorted(soil) else "yes",
              "on slippery ground a plan takes longer. Lower curvature, as 7.2.2 says, "
              + ("comes out" if bend[-1] < bend[0] else "does not come out")),
        Claim("7.2.3, (54)", "with (54) instead of trees 18 s become 1.64 s, less accurate",
              f"{1e3 * results.seconds['optimal, (54)'].median:.2f} against "
              f"{1e3 * results.seconds['optimal'].median:.2f} ms with a fitted table; at the end "
              f"{r.exponential.mean():.2f} against {r.table.mean():.3f} m from the goal",
              verdict(r.exponential.mean() > 2.0 * r.table.mean(),
                      spent["optimal, (54)"] < 0.5 * spent["optimal"]),
              "less accurate, but no faster here: a fitted surface costs as little as (54)"),
        Claim("7.2.3, Table 5", "0.06 s Dubins, 0.022 s clothoid, 1.64 s to 18 s optimal",
              ", ".join(f"{n} {1e3 * s.median:.2f} ms" for n, s in results.seconds.items()),
              "-", f"CPU time of a plan with its samples, median of {len(results.dubins)} goals, "
              f"least of three; {results.machine}. The paper names no machine"),
    ]  # fmt: skip


def planning_claims(results: Planning) -> list[Claim]:
    """All, in the order of the paper."""
    return [*path_claims(results), *tracking_claims(results), *model_claims(results)]
