"""Sections 8.1 and 8.2: nonuniform against uniform load, and stiffness that grows with speed.

8.1 drives the chicane F (53) without feedback, 0.8 m/s and 0.6 rad/s, on both load models. The
paper gives neither place nor heading. The code of the authors (github.com/mfocchi/
tracked_robot_simulator, not part of this project) drives another reference there: 0.8 m/s from the
beginning, and a yaw rate that falls linearly from 0.6 to -0.6 rad/s. Both are run. In closed form,
under damping D per track the roll of the vehicle decays at
    d_A A (B^2/4 + w^2/12) / I_x,    d_A A = 2 D
and explicit steps of dt need less than 2 / dt.

8.2 drives straight on soft level ground, 0 to 1.4 m/s in 10 s, F (19). The stiffness of the
foremost patches is
    K = K_t (1 + K_tp v_x (l + x)),    x = l (1 - 1/n_x)
where they touch the ground. Table 2 gives K_t per track; the code of the authors multiplies it by
the area of the track for each patch, F (18), so that their ground is stiffer: PER_AREA.

Reference: [1] Focchi et al. (2025), sections 2.2, 8.1 and 8.2.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import root

from baselines.lyapunov.lyapunov_laws import sprockets_for
from reproduce.focchi2025.control import chicane, vehicle
from reproduce.policy_runs import Floats
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants.standalone import TerrainRig
from tracked_env.references import ReferenceProfile, sample
from tracked_env.references.profile import constant, knot_times, number_of_segments

FRICTION = 0.6  # [-] mu of 8.1 and 8.3
SPEED, TURN = 0.8, 0.6  # [m/s], [rad/s] of 8.1
DURATION, SAMPLE = 20.0, 0.01  # [s]
TRACK_AREA = 0.07  # [m^2] A_t of Table 2, by which stiffness and damping are divided
DAMPING = {"Table 2": 5e3, "as 8.1 prints": 50e3}  # [N s/m] D_t
HEIGHT, ROLL_INERTIA = 0.25, 2.18  # [m], [kg m^2] of Table 2, for either contact length
COMMANDS = {"(53)": "(53): straight, left, right", "linear": "authors' code: w falls linearly"}
HEADINGS = (0.0, -2.9)  # [rad] of the authors' code, and the third number of c_0 in 8.3
SCRIPTED = (19.0, 3.0, 0.0)  # [m], [m], [rad] of the authors' open loop; their loop of 8.3: (15, 2)
LOADS = ("nonuniform", "uniform")
SOFT, TOP_SPEED, RISE = 5e3, 1.4, 10.0  # [N/m] K_t, [m/s], [s] of 8.2
PAIRS = {"printed": (10.5, 0.7), "fits": (5.5, 0.5)}  # K_tp [s/m^2] and contact length [m]
PRINTED_STIFFNESS = 23e3  # [N/m] F, figure 21
ALONG, ACROSS = 10, 4  # [-] n_x, n_y
PER_AREA = {"per track": 1.0 / TRACK_AREA, "as coded": float(ALONG * ACROSS)}  # [1/m^2] k_A / K_t


class Soil(NamedTuple):
    """Ground of the open loop."""

    friction: float  # [-] mu
    stiffness: float  # [N/m] K_t of a track
    damping: float  # [N s/m] D_t of a track


# Table 2 with mu of 8.1, and the test on slopes in the code of the authors
SOILS = {"Table 2": Soil(FRICTION, 1e5, DAMPING["Table 2"]), "authors": Soil(0.7, 1e4, 1e3)}


class OpenLoop(NamedTuple):
    """Time histories of N vehicles over T samples."""

    positions: Floats  # (T, 3, N) [m]
    balance: Floats  # (T, N) [-] load of the left track less that of the right one, over their sum
    saturated: Floats  # (N,) [-] share of the samples at which the uniform load has a bound
    reference: Floats  # (T, 2) [m] of the first vehicle, level ground and no slip


def profile_of(commands: str) -> ReferenceProfile:
    """Speed and yaw rate of 8.1, one of COMMANDS, from the origin."""
    if commands == "(53)":
        return chicane(DURATION, SPEED, TURN)
    starts = knot_times(number_of_segments(DURATION))[:-1]
    turn = constant(0.0, len(starts))
    turn[:, 0], turn[:, 1] = TURN * (1.0 - 2.0 * starts / DURATION), -2.0 * TURN / DURATION
    return ReferenceProfile(constant(SPEED, len(starts)), turn)


def belts(parameters: PlantParameters, speed: Floats, yaw_rate: Floats) -> Floats:
    """Sprocket speeds (T, 2) [rad/s] of a unicycle, F (26), without a limit."""
    motion = np.stack([speed, yaw_rate], axis=1)
    row, sprockets = np.ones(len(motion)), np.empty_like(motion)
    half, radius = 0.5 * parameters.track_gauge, parameters.sprocket_radius
    sprockets_for(motion, 0.0 * motion, half * row, radius * row, np.inf * row, sprockets)
    return sprockets


def drive(
    terrain: Any,
    load: str,
    starts: Sequence[tuple[float, float, float]],
    commands: str,
    soil: Soil = SOILS["Table 2"],
) -> OpenLoop:
    """8.1 from starts x, y [m], yaw [rad] on a terrain."""
    parameters = vehicle(friction=soil.friction)
    options = {
        "terrain": terrain,
        "load": load,
        "stiffness": soil.stiffness / TRACK_AREA,
        "damping": soil.damping / TRACK_AREA,
    }
    rig = TerrainRig(parameters, options, len(starts))
    for row, start in enumerate(starts):
        rig.stand(*start, row)
    time = SAMPLE * np.arange(round(DURATION / SAMPLE) + 1)
    x, y, yaw = starts[0]
    reference = sample(profile_of(commands)._replace(x=x, y=y, yaw=yaw), time)
    sprockets = belts(parameters, reference.speed, reference.yaw_rate)
    positions, balance, saturated = [], [], np.zeros(len(starts))
    for k in range(len(time)):
        positions.append(rig.positions.T)
        left, right = rig.track_loads.T
        balance.append((left - right) / np.maximum(left + right, 1e-9))
        saturated += rig.saturated
        rig.advance(np.tile(sprockets[k], (len(starts), 1)), SAMPLE)
    planned = np.stack([reference.x, reference.y], axis=1)
    return OpenLoop(np.array(positions), np.array(balance), saturated / len(time), planned)


def gap(one: OpenLoop, other: OpenLoop) -> Floats:
    """Horizontal distance of the ends of two runs, (N,) [m]."""
    return np.asarray(np.hypot(*(one.positions[-1] - other.positions[-1])[:2]))


def length(run: OpenLoop) -> Floats:
    """Horizontal length of the driven paths, (N,) [m]."""
    steps = np.diff(run.positions[:, :2], axis=0)
    return np.asarray(np.hypot(steps[:, 0], steps[:, 1]).sum(axis=0))


def roll_decay(damping: float) -> float:
    """Rate [1/s] at which roll decays under damping [N s/m] per track, in closed form."""
    p = vehicle()
    arm = 0.25 * p.track_gauge**2 + p.track_width**2 / 12.0
    return 2.0 * damping * arm / ROLL_INERTIA


def measured_roll_decay(damping: float) -> float:
    """The same from the plant on soft ground: the roll rate before and after 10 steps."""
    step = 1e-5  # [s]
    options = {"damping": damping / TRACK_AREA, "stiffness": 1e6, "patches": (ALONG, 8)}
    rig = TerrainRig(vehicle(friction=1e-4), options, step=step)
    rig.stand(0.0, 0.0, 0.0)
    x, y, z = rig.positions[0]
    rig.place((x, y, z), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.01, 0.0, 0.0))
    before = float(rig.states[0, s.ROLL_RATE])
    rig.advance([[0.0, 0.0]], 10.0 * step)
    return math.log(before / float(rig.states[0, s.ROLL_RATE])) / (10.0 * step)


def load_on_a_side_slope(angle: float) -> tuple[float, float]:
    """(plant, closed form) of the balance [-] of a vehicle that stands across a slope [rad].

    Closed form: y_cp = h tan(s + tilt) on a pressure that is linear over both tracks, so that
    (N_low - N_high) / N = y_cp (B/2) / (B^2/4 + w^2/12).
    """
    parameters = vehicle(friction=FRICTION)
    terrain = {"kind": "plane", "slope_y": math.tan(angle)}
    rig = TerrainRig(parameters, {"terrain": terrain, "patches": (ALONG, 8)})
    rig.stand(0.0, 0.0, 0.0)
    rig.advance([[0.0, 0.0]], 2.0)
    left, right = rig.track_loads[0]
    half, width = 0.5 * parameters.track_gauge, parameters.track_width
    arm = HEIGHT * math.tan(float(rig.states[0, s.ROLL]))
    expected = arm * half / (half**2 + width**2 / 12.0)
    return float((right - left) / (left + right)), expected


class Stiffening(NamedTuple):
    """8.2 with one pair of K_tp and contact length, over the speed."""

    speed: Floats  # (T,) [m/s] v_x
    stiffness: Floats  # (T,) [N/m] K of the foremost patches that touch the ground
    pitch: Floats  # (T,) [rad] nose down
    held: float  # [rad] pitch of the plant after the top speed was held
    equilibrium: float  # [rad] the same from the balance of force and moment
    raised: bool  # whether the foremost patches leave the ground on the way


def places(contact_length: float) -> Floats:
    """x [m] of the patches of a track, front first."""
    columns: Floats = np.arange(ALONG, dtype=np.float64)
    return 0.5 * contact_length * (1.0 - (2.0 * columns + 1.0) / ALONG)


def stiffness_at(x: float, stiffening: float, contact_length: float, speed: float) -> float:
    """K [N/m] of F (19) at x [m] and a speed [m/s] >= 0."""
    return SOFT * (1.0 + stiffening * speed * (x + 0.5 * contact_length))


def foremost(stiffening: float, contact_length: float, speed: float) -> float:
    """K [N/m] of the foremost patches at a speed [m/s]: the closed form of 8.2."""
    return stiffness_at(float(places(contact_length)[0]), stiffening, contact_length, speed)


def equilibrium(
    parameters: PlantParameters, stiffening: float, speed: float, per_area: float
) -> float:
    """Pitch [rad, nose down] at constant speed [m/s], from the balance of force and moment.

    The thrust that overcomes the rolling resistance acts at the ground as that does: the two have
    no moment together. Loads: springs of F (19), pressed by z and pitch, never pulling; per_area
    as in PER_AREA. Raises ValueError where no balance is found.
    """
    half, weight = 0.5 * parameters.contact_length, parameters.mass * GRAVITY
    x = places(parameters.contact_length)
    area = 2.0 * parameters.track_width * parameters.contact_length / ALONG
    springs = [stiffness_at(float(one), stiffening, 2.0 * half, speed) for one in x]
    stiffness = area * per_area * np.array(springs)

    def unbalanced(unknown: Floats) -> list[float]:
        sinkage, pitch = unknown
        sine, cosine = math.sin(pitch), math.cos(pitch)
        load = stiffness * np.maximum(sinkage + x * sine - HEIGHT * (1.0 - cosine), 0.0)
        arm = x * cosine - HEIGHT * sine  # horizontal, of a vertical force
        return [float(load.sum() / weight - 1.0), float(load @ arm / (weight * half))]

    solved = root(unbalanced, [weight / stiffness.sum(), -0.1])
    if not solved.success:
        raise ValueError(f"no balance at {speed} m/s with K_tp = {stiffening} s/m^2")
    return float(solved.x[1])


def stiffen(stiffening: float, contact_length: float, per_area: float) -> Stiffening:
    """8.2 on level ground: K_tp [s/m^2], length [m], per_area as in PER_AREA."""
    parameters = vehicle(contact_length, FRICTION)
    options = {
        "stiffness": SOFT * per_area,
        "damping": DAMPING["Table 2"] * per_area,
        "stiffening": stiffening,
        "centre_of_mass_height": HEIGHT,
        "patches": (ALONG, ACROSS),
    }
    rig = TerrainRig(parameters, options)
    rig.stand(0.0, 0.0, 0.0)
    rig.advance([[0.0, 0.0]], 2.0)
    top = TOP_SPEED / parameters.sprocket_radius
    time = SAMPLE * np.arange(round(RISE / SAMPLE) + 1)
    x, rows, raised = places(contact_length), [], False
    for k, now in enumerate(time):
        speed, pitch = (float(value) for value in rig.states[0, [s.V_X, s.PITCH]])
        above = rig.positions[0, 2] - x * math.sin(pitch) - HEIGHT * math.cos(pitch)
        first = int(np.argmax(above < 0.0))
        raised = raised or first > 0
        stiffness = stiffness_at(float(x[first]), stiffening, contact_length, speed)
        rows.append((speed, stiffness, pitch))
        if k + 1 < len(time):
            begins, ends = ([[t / RISE * top] * 2] for t in (now, time[k + 1]))
            rig.advance(begins, SAMPLE, to=ends)
    speeds, largest, pitches = np.array(rows).T
    rig.advance([[top, top]], RISE)
    level = equilibrium(parameters, stiffening, float(rig.states[0, s.V_X]), per_area)
    return Stiffening(speeds, largest, pitches, float(rig.states[0, s.PITCH]), level, raised)
