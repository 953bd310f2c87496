"""What the paper claims in sections 4 to 8, what comes out, and whether the two agree.

Every number is computed from the runs; so is every verdict.
"""

import math

import numpy as np

from baselines.slip.slip_regression import Scores
from reproduce.focchi2025 import chicane, spiral
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025.chicane import Case
from reproduce.focchi2025.planning_claims import planning_claims
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.runs import BEGUN, LENGTHS, RESISTANCE, Floats, Run, vehicle
from reproduce.focchi2025.slope_claims import slope_claims
from reproduce.paper_page import Claim, verdict

RATE = chicane.RATES[0]  # [Hz] of the paper's simulation
REAL = (0.91, 0.84, 0.961)  # R^2 of F for the real vehicle: beta_left, beta_right, alpha
GOAL = 0.20  # [-] largest loss of accuracy that a wrong assumed friction may leave
TURNS = (slice(2.5, 12.0), slice(13.0, 20.0))  # [s] of the chicane, without its jumps


def three(scores: Scores) -> str:
    """R^2 of beta_left, beta_right and alpha forward."""
    return " / ".join(f"{value:.4g}" for value in scores[:3])


def cm(value: float) -> str:
    """A length in cm."""
    return f"{100.0 * value:.1f} cm"


def identification_claims(results: Results) -> list[Claim]:
    """Section 4 and 7.2.3."""
    found = results.identification
    simulated, real = found.simulated, found.measured
    runs = found.by_friction
    low, middle, high = (runs[mu] for mu in ident.FRICTIONS)
    at_low, at_middle = ident.share_above(low, middle), ident.share_above(middle, high)
    claims = []
    if simulated.held_out is None or simulated.unseen is None:
        claims.append(Claim("4.2, 4.3", "R^2 of the regressors 0.999 in simulation",
                            "not computed", "-", found.missing))  # fmt: skip
    else:
        claims.append(
            Claim(
                "4.2, 4.3, figs 6, 7",
                "simulation, mu = 0.1: R^2 = 0.999 for beta_L, beta_R, alpha",
                f"{three(simulated.held_out)} on held-out points, {three(simulated.unseen)} on "
                "runs not seen before the upsampling",
                verdict(min(simulated.held_out[:3]) > 0.999, min(simulated.unseen[:3]) > 0.999),
                f"{len(low.v_x)} runs held until steady, upsampled to 0.1 rad/s",
            ),
        )
    brief = found.brief
    claims.append(
        Claim(
            "4.2",
            "2 s of constant speed reach a steady state",
            f"beta after 2 s from rest: R^2 {brief.determination[0]:.3f} against the steady one; "
            f"alpha: {brief.determination[2]:.2f}, size {brief.slope[2]:.2f} times; within "
            f"±4.6 rad/s {found.brief_slow.determination[0]:.4f} and "
            f"{found.brief_slow.determination[2]:.4f}",
            verdict(brief.determination[0] > 0.98, brief.determination[2] > 0.98),
            "at mu = 0.1 fast turns need longer; F may go from one pair to the next without a stop",
        ),
    )
    if real is not None:
        if real.held_out is not None and real.unseen is not None:
            agree = [abs(a - b) < 0.05 for a, b in zip(real.unseen[:3], REAL, strict=True)]
            claims.append(
                Claim(
                    "4.2, 4.3, figs 6, 7",
                    "real vehicle: R^2 = 0.91, 0.84, 0.961",
                    f"{three(real.unseen)} on runs not seen; {three(real.held_out)} on held-out "
                    "upsampled points",
                    verdict(*agree),
                    "a test set split off after the upsampling has neighbours 0.1 rad/s away in "
                    "the training set; the paper's numbers look like those of unseen runs",
                ),
            )
        beta = {n: (a.correlation[:2], a.slope[:2]) for n, a in found.against_measured.items()}
        claims.append(
            Claim("4.4, fig. 9", "good quantitative match of beta within ±4.6 rad/s",
                  "; ".join(
                      f"{n:g} m: correlation {c.min():.2f}, real / simulated {s[0]:.2f} (left), "
                      f"{s[1]:.2f} (right)" for n, (c, s) in beta.items()
                  ), verdict(*(abs(s.mean() - 1.0) < 0.3 for _, s in beta.values())),
                  "the trend is there; the size is nearer with 0.5 m (mu = 0.1, c_r = 0.025); the "
                  "real right track slips less than the left"),
        )  # fmt: skip
        alpha = found.against_measured[LENGTHS[-1]]
        behind, moved = found.behind[LENGTHS[-1]]
        claims.append(
            Claim(
                "4.4, fig. 9",
                "only a qualitative match of alpha, perhaps for rubber on floor",
                f"forward real / simulated {alpha.slope[2]:.1f}, reverse {alpha.slope[3]:.1f}: "
                f"the sign of the reverse is another. A point {cm(behind)} behind the turning "
                f"centre would have R^2 {moved.determination[2]:.2f} / "
                f"{moved.determination[3]:.2f} instead of "
                f"{alpha.determination[2]:.2f} / {alpha.determination[3]:.2f}; fitted forward "
                f"alone it is {cm(found.behind_each[0])}, in reverse alone "
                f"{cm(found.behind_each[1])}",
                "yes",
                "-w d / v_x has one sign forward and in reverse, slip has two: a hypothesis, "
                "which neither the paper nor other runs support",
            ),
        )
    claims += [
        Claim(
            "4.3, fig. 8",
            "alpha grows on slippery ground; mu = 0.4 and 0.6 are very similar",
            f"0.1 against 0.4: {at_low:.1f} times; 0.4 against 0.6: {at_middle:.2f} times (rms)",
            verdict(at_low > 1.5, at_middle < 0.5 * (1.0 + at_low)),
            "mu = 0.1, 0.4, 0.6, forward",
        ),
    ]
    return claims


def spiral_claims(results: Results) -> list[Claim]:
    """Figure 10."""
    uc, slc = results.spiral["uc"], results.spiral["slc"]
    beyond = spiral.beyond_after(vehicle())
    half = len(uc.value) // 2
    late = {kind: float(s.run.distance[half:].max()) for kind, s in results.spiral.items()}
    return [
        Claim("5.2, fig. 10", "w_d = 4 t, v_d = 0.3 m/s",
              f"outer sprocket beyond 10 rad/s after {beyond:.2f} s", "-",
              "the figure is kinematic and has no such limit, but slip was identified up to there; "
              "here w_d = 0.05 t"),
        Claim("5.2, fig. 10", "the SLC converges, the UC does not on slipping tracks",
              f"at the end UC {cm(uc.run.distance[-1, 0])}, SLC {cm(slc.run.distance[-1, 0])}; "
              f"largest in the second half {cm(late['uc'])} / {cm(late['slc'])}",
              verdict(late["slc"] < 0.5 * late["uc"]),
              "start 42 cm off; the lateral error leaves within k_phi / v_d^2, 11 s at 0.3 m/s"),
        Claim("5.2, (48)", "the Lyapunov function of the SLC never rises",
              f"{slc.value[0]:.3f} falls to {slc.value[-1]:.1g}, rises at most {slc.rises:.1g}; "
              f"that of the UC rises by {uc.rises:.2g}", verdict(slc.rises < 1e-3),
              "the rest is the term in alpha - alpha_d that (48) leaves out, and the control "
              f"period {1e3 / spiral.RATE:g} ms"),
    ]  # fmt: skip


def prediction(
    runs: dict[Case, Run], predicted: dict[Case, tuple[Floats, Floats, Floats]], case: Case
) -> dict[str, tuple[float, float, float]]:
    """Figure 14: {channel: (rms actual, rms error in the turns, rms error within 1 s of jumps)}."""
    run = runs[case]
    actual = run.slip(vehicle(case.length, case.friction, case.resistance))
    time = run.time
    turning = np.zeros(len(time), dtype=bool)
    for part in TURNS:
        turning |= (time >= part.start) & (time < part.stop)
    jumps = np.zeros(len(time), dtype=bool)
    for jump in (chicane.TURN_TIME, chicane.SWITCH_TIME):
        jumps |= (time >= jump) & (time < jump + 1.0)
    found = {}
    names = ("beta_left", "beta_right", "alpha")
    for name, true, expected in zip(names, actual, predicted[case], strict=True):

        def rms(values: Floats, rows: np.ndarray) -> float:
            return float(np.sqrt(np.nanmean(np.square(values[rows])))) if rows.any() else math.nan

        error = true[:, 0] - expected
        found[name] = (rms(true[:, 0], turning), rms(error, turning), rms(error, jumps))
    return found


def chicane_claims(results: Results) -> list[Claim]:
    """Section 7.1."""
    numbers = {case: run.numbers() for case, run in results.chicane.items()}
    paper = {(kind, n): numbers[Case(kind, n, RATE)] for kind in chicane.KINDS for n in LENGTHS}
    short, long = LENGTHS
    plain = results.readings["v_max t / t_1", short, 0.0, "uc"]
    ramp = {n: results.readings["v_max t / t_1", n, RESISTANCE, "table"].largest for n in LENGTHS}
    heading = {key: one.heading for key, one in paper.items()}
    end = results.chicane[Case("table", long, RATE)].time[-1]
    shown = prediction(results.chicane, results.predicted, Case("table", long, RATE))
    share = [shown[name][1] / shown[name][0] for name in shown]
    jump = [shown[name][2] / shown[name][1] for name in ("beta_left", "beta_right")]
    return [
        Claim("7.1, fig. 13", "UC: at most 10 cm off",
              f"0.5 m: {paper['uc', short].text} cm, 0.7 m: {paper['uc', long].text} cm",
              verdict(*(abs(paper["uc", n].largest - 0.1) < 0.03 for n in LENGTHS)),
              f"from {BEGUN:g} s on. Slip with Table 2's 0.7 m is nearly twice that with 0.5 m; "
              f"with 0.5 m, without rolling resistance and with a ramp to v_max, it is "
              f"{cm(plain.largest)}"),
        Claim("7.1, fig. 13", "SLC: always below 3 cm",
              f"0.5 m: {paper['table', short].text} cm, 0.7 m: {paper['table', long].text} cm",
              verdict(*(paper["table", n].largest < 0.03 for n in LENGTHS)),
              "from 3 s on: the start is 5.8 cm off. The lateral error leaves in k_phi / v_d^2, "
              f"{1.0 / chicane.SPEED**2:.0f} s, so most of the start and the jumps is left; "
              f"with a ramp to v_max {cm(ramp[short])} and {cm(ramp[long])}"),
        Claim("7.1, fig. 13", "the orientation is better with the SLC as well",
              "; ".join(f"{n:g} m: UC {heading['uc', n]:.3f}, SLC {heading['table', n]:.3f} rad"
                        for n in LENGTHS),
              verdict(*(heading["table", n] < heading["uc", n] for n in LENGTHS)),
              "largest; the SLC tracks the direction of motion, its heading rests at -alpha_d"),
        Claim("7.1, fig. 14", "beta predicted well but for jumps of the velocity, and alpha",
              f"error / size in the turns: {share[0]:.2f}, {share[1]:.2f}, alpha {share[2]:.2f}; "
              f"in the second after a jump beta is {min(jump):.1f} times worse at least",
              verdict(max(share[:2]) < 0.2, min(jump) > 2.0, share[2] < 0.2),
              f"0.7 m, {RATE} Hz, {end:.0f} s; rms"),
    ]  # fmt: skip


def further_claims(results: Results) -> list[Claim]:
    """Comparisons that the paper leaves open or does not make."""
    numbers = {case: run.numbers() for case, run in results.chicane.items()}
    loss, wrong = [], []
    for length in LENGTHS:
        for true, assumed in chicane.SOILS:
            known = numbers[Case("table", length, friction=true, believed=true)]
            guess = numbers[Case("table", length, friction=true, believed=assumed)]
            found = numbers[Case("online", length, friction=true, believed=assumed)]
            loss += [found.largest / known.largest - 1.0, found.rmse / known.rmse - 1.0]
            wrong.append(guess.largest / known.largest)
    by_rate = [
        max(numbers[Case(kind, n, rate)].largest for rate in chicane.RATES)
        / min(numbers[Case(kind, n, rate)].largest for rate in chicane.RATES)
        for kind in chicane.KINDS
        for n in LENGTHS
    ]
    c_r = {
        n: (
            numbers[Case("uc", n)].largest,
            numbers[Case("uc", n, resistance=0.0, believed_resistance=0.0)].largest,
            numbers[Case("table", n)].largest,
            numbers[Case("table", n, resistance=0.0, believed_resistance=0.0)].largest,
        )
        for n in LENGTHS
    }
    integrated = {key: run.numbers().largest for key, run in results.integrators.items()}
    apart = max(
        abs(integrated[name, kind] - integrated["Rosenbrock, 1 ms", kind])
        for name, kind in integrated
    )
    slow = {n: numbers[Case("exponential, slow", n)].largest for n in LENGTHS}
    blind = {n: c_r[n][0] for n in LENGTHS}
    fast = {n: numbers[Case("exponential", n)].largest for n in LENGTHS}
    return [
        Claim("7.2.3, (54)", "exponential in the turning radius: less accurate, acceptable",
              f"R^2 {three(results.identification.simulated.exponential_fit)}; chicane: "
              + "; ".join(f"{n:g} m: {cm(fast[n])} fitted to all runs, {cm(slow[n])} to those "
                          f"within 4.6 rad/s, UC {cm(blind[n])}, regressor {cm(c_r[n][2])}"
                          for n in LENGTHS),
              verdict(*(fast[n] < blind[n] for n in LENGTHS), *(slow[n] < blind[n]
                        for n in LENGTHS)),
              "slip depends on speed as well, as 4.2 says: c_1 of fast runs overstates it at "
              "0.2 m/s; and rolling resistance loads the outer track, which (54) cannot say"),
        Claim("7.1", "(not in the paper) wrong friction assumed, 0.4 for 0.1 or 0.1 for 0.4: "
              "on-line identification loses at most 20 %",
              f"on-line: at most {100 * max(loss):+.1f} % (max and RMSE, both lengths); without "
              f"it the error is {min(wrong):.1f} to {max(wrong):.1f} times as large",
              verdict(max(loss) < GOAL),
              "from 3 s on, 200 Hz, ideal sensors, against the regressor of the true friction"),
        Claim("7.1", "control at 1 kHz (simulation), 200 Hz (vehicle)",
              f"1000, 200 and 50 Hz differ by at most {100 * (max(by_rate) - 1):.1f} %",
              verdict(max(by_rate) < 1.1), "largest error, both controllers and lengths"),
        Claim("Table 2", "c_r = 0.025",
              "; ".join(f"{n:g} m: UC {cm(a)}, without {cm(b)}; SLC {cm(c)}, without {cm(d)}"
                        for n, (a, b, c, d) in c_r.items()), "-",
              "it is a quarter of the friction at mu = 0.1: it counts, and the regressor has to be "
              "trained with it"),
        Claim("2.3, Table 2", "explicit integration with 1 ms",
              f"Euler and Rosenbrock differ by at most {1e3 * apart:.2g} mm", verdict(apart < 1e-3),
              "largest error of the chicane, 0.7 m, without noise"),
    ]  # fmt: skip


def claims(results: Results) -> list[Claim]:
    """All, in the order of the paper."""
    return [
        *identification_claims(results),
        *spiral_claims(results),
        *chicane_claims(results),
        *further_claims(results),
        *planning_claims(results.planning),
        *slope_claims(results.slopes),
    ]
