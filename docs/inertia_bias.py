"""Why the inertia is found too small on soil that gives way: a table of observer_trust.md.

    python -m docs.inertia_bias        prints the medians of 12 vehicles

The yaw equation of the estimators is M = I dw/dt + C g S(v_y, w), M the moment of the tracks. On
the distributed plant the moment of friction M_f is no function of v_y and w alone: the shear of a
patch points along its slip velocity, so what a track pulls is missing across it. Its state holds no
shear, so M_f depends on the present motion and slips, and nothing lags. Of each instant driven:
    M_f    as it is, with the efforts F_L, F_R that speed the yaw up
    M_f0   at the same v_x, w, a_y and F_L + F_R, with the efforts of a steady turn, I dw/dt = 0
The slope of M_f - M_f0 over dw/dt is what the sharing of friction adds to the inertia (`coupling`).
It is compared with the bias of least squares on the true motion without noise, and with its limit.
Where all shear slides (K -> 0), the motion (beta_k, w) of a track is normal to the limit of its
force and moment, beta_k dF_k + w dM_k = 0 [1], so that
    I_found / I = 1 / (1 + (beta_R - beta_L) / (w B)) = w B / (belt_R - belt_L) = 1 - s
with s the slip share. Where shear is elastic (K large), force and moment do not share: no bias.

References: [1] S. Goyal, A. Ruina, J. Papadopoulos, Wear 143 (1991) 307, limit surface.
"""

from typing import Any

import numpy as np

from baselines.estimators import turning
from baselines.registry import oracle
from docs.observer_runs import Floats
from tracked_env.arrays import columns
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.physics import level_motion, lumped, parameters
from tracked_env.physics import patches_on_level_ground as level
from tracked_env.physics.jit import loop
from tracked_env.physics.lumped import Motion
from tracked_env.vector_env import TrackedVehicleVectorEnv

SEED, EPISODES = 72_000, 12
START = 50  # [control steps] left out before it
CLOSE, ACCURACY = 1e-3, 1.0  # [N] Newton's steps end, and are good enough
LONGEST = 0.2  # [m/s] step of Newton's method
PATCHES = level.make_patches()
_USED = ("v_x", "v_y", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right")
FRICTION, STEADY, LEFT_OVER, YAW_ACCELERATION = range(4)  # columns of `moments`
MODULUS, LENGTH = "shear_deformation_modulus", "contact_length"


@loop
def loads(scratch, p, v_x, v_y, yaw_rate, left, right, patches):
    """(F_L, F_R, F_y, yaw moment, R_R - R_L) on vehicle p with belts at these speeds [m/s]."""
    k, drive = lumped.coefficients(p, False), lumped.drive_limits(p)
    contact = level.contact_of(p, k, drive, patches)
    motion, belts = Motion(v_x, v_y, yaw_rate), level.Belts(left, right)
    r = level.resistance(scratch, motion, belts, (contact, contact), patches)
    f = level_motion.loads_of(r, motion, belts, k, (k.resistance, k.resistance))
    rolling = f.resistance_right - f.resistance_left
    return np.array((f.effort_left, f.effort_right, f.lateral_force, f.turning_moment, rolling))


@loop
def belts_of(scratch, p, v_x, yaw_rate, target, guess, patches):
    """(v_y, belts) with F_L, F_R, F_y = target, by Newton's method; and the largest miss [N]."""
    x, miss = guess.copy(), np.inf
    for _ in range(30):
        now = loads(scratch, p, v_x, x[0], yaw_rate, x[1], x[2], patches)[:3] - target
        miss = np.abs(now).max()
        if miss < CLOSE:
            break
        slopes = np.zeros((3, 3))
        for c in range(3):
            moved = x.copy()
            moved[c] += 1e-6
            then = loads(scratch, p, v_x, moved[0], yaw_rate, moved[1], moved[2], patches)[:3]
            slopes[:, c] = (then - target - now) / 1e-6
        step = np.linalg.solve(slopes, now)
        x -= step * min(1.0, LONGEST / np.abs(step).max())
    return x, miss


@loop
def moments(motion, row, patches, out):
    """M_f, M_f0 [N m], miss [N] and dw/dt of each instant; motion (T, 5) as _USED, row (1, P)
    parameters, out (T, 4)."""
    scratch = np.empty((level.SCRATCH_ROWS, level.LANES))
    p = parameters.row_parameters(row, 0, 0)
    gauge, radius = p.track_gauge, p.sprocket_radius
    for t in range(motion.shape[0]):
        v_x, v_y, w = motion[t, 0], motion[t, 1], motion[t, 2]
        x = np.array((v_y, motion[t, 3] * radius, motion[t, 4] * radius))
        a = loads(scratch, p, v_x, v_y, w, x[1], x[2], patches)
        friction = 0.5 * gauge * (a[1] - a[0] - a[4]) - a[3]
        steady, miss, both, rolling = friction, 0.0, a[0] + a[1], a[4]
        for _ in range(12):
            apart = 2.0 * steady / gauge + rolling
            target = np.array((0.5 * (both - apart), 0.5 * (both + apart), a[2]))
            x, miss = belts_of(scratch, p, v_x, w, target, x, patches)
            b = loads(scratch, p, v_x, x[0], w, x[1], x[2], patches)
            before, steady = steady, 0.5 * gauge * (b[1] - b[0] - rolling) - b[3]
            if abs(steady - before) < CLOSE:
                break
        out[t, FRICTION], out[t, STEADY], out[t, LEFT_OVER] = friction, steady, miss
        out[t, YAW_ACCELERATION] = a[3] / p.inertia


@loop
def regressor(v_y, yaw_rate, constants, out):
    """S g of each instant into out (T,)."""
    for t in range(v_y.size):
        out[t] = turning.unit_moment(v_y[t], yaw_rate[t], constants)


def drive(reset: dict[str, Any], count: int, steps: int) -> tuple[Floats, Floats]:
    """True motion (T, N, 5) as _USED and parameters (N, P) on loose soil, known to the driver."""
    options = {"expose_truth": True, "duration": 0.02 * steps, "autoreset_mode": "Disabled"}
    env = TrackedVehicleVectorEnv(
        count, uncertainty="loose-soil", plant="distributed", sensors="ideal", **options
    )
    policy, state = oracle(BenchmarkConfig().context("distributed")), None
    observation, info = env.reset(seed=[SEED + i for i in range(count)], options=reset)
    batch, used = env.simulation.batch, columns(_USED)
    rows, motion = batch.floats[:, columns(parameters.PARAMETER_NAMES)].copy(), []
    for _ in range(steps):
        policy.observe_truth(info["truth"])
        action, state = policy.predict(observation, state)
        motion.append(batch.floats[:, used].copy())
        observation, *_, info = env.step(action)
    return np.array(motion), rows


def bias(motion: Floats, row: Floats) -> tuple[float, float, float]:
    """Relative bias of the inertia of the vehicle with parameters `row` (P,) along motion (T, 5).

    Of least squares on the true motion with the equation of the estimators; the slope of
    M_f - M_f0 over dw/dt; the slip share s of the yaw rate of the belts.
    """
    p = parameters.PlantParameters(*row)
    out = np.zeros((len(motion), 4))
    moments(np.ascontiguousarray(motion), row[None].copy(), PATCHES, out)
    k = turning.TurningEstimator(p).constants()[0]
    v_x, v_y, w, left, right = motion.T
    slow = np.minimum(np.abs(v_x - k.half_gauge * w), np.abs(v_x + k.half_gauge * w))
    use = (np.abs(w) > k.least_turn) & (slow > k.slowest) & (out[:, LEFT_OVER] < ACCURACY)
    use[:START] = False
    bend, s = out[:, YAW_ACCELERATION], np.empty(len(w))
    regressor(np.ascontiguousarray(v_y), np.ascontiguousarray(w), k, s)
    moment = p.inertia * bend + out[:, FRICTION]
    inertia, _c = np.linalg.lstsq(np.stack([bend, s], axis=1)[use], moment[use], rcond=None)[0]
    shared, bend = (out[:, FRICTION] - out[:, STEADY])[use], bend[use]
    turned, belts = w[use] * p.track_gauge, (right - left)[use] * p.sprocket_radius
    return (
        float(inertia / p.inertia - 1.0),
        float(shared @ bend / (bend @ bend) / p.inertia),
        float(1.0 - turned @ turned / (turned @ belts)),
    )


def biases(reset: dict[str, Any], count: int = EPISODES, steps: int = 1050) -> Floats:
    """`bias` (N, 3) of `count` vehicles with these options of reset."""
    motion, rows = drive(reset, count, steps)
    return np.array([bias(motion[:, i], rows[i]) for i in range(count)])


def eight(speed: float) -> dict[str, Any]:
    """An eight that takes 20 s at this speed [m/s]: whole ones do not confuse dw/dt with w."""
    return {"kind": "figure_eight", "speed": speed, "size": 7.5 * speed}


if __name__ == "__main__":
    CASES = {f"speed {v:g} m/s, eights": {"reference": eight(v)} for v in (1.0, 2.0, 3.0)}
    CASES |= {f"contact length {x:g} m": {"vehicle": {LENGTH: x}} for x in (1.4, 2.0, 2.8)}
    CASES |= {f"K {x:g} m": {"soil": {MODULUS: x}} for x in (0.001, 0.01, 0.02, 0.05, 0.1)}
    for name, options in CASES.items():
        squares, coupling, share = 100.0 * np.median(biases(options), axis=0)
        print(f"{name}: {squares:.0f}, {coupling:+.0f}, {-share:.0f} %", flush=True)
