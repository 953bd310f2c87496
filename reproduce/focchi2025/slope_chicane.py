"""Section 8.3: the chicane F (53) in closed loop on uneven ground, figures 22 and 23.

Both controllers take the pose error in the vehicle's plane, F (49) with the yaw counted once. The
slippage-aware one has slip of level ground ("flat") or over the direction of gravity: that of
the load that acts ("slope"), or that of uniform load whatever acts ("uniform").
c_0 = [15, 2, -2.9] m is read as a place and a heading: the mesh has no height of -2.9 m. mu = 0.6,
0.6 m/s and 0.4 rad/s; control at 200 Hz. As (53) prints it the speed reaches 1.2 m/s, 14 rad/s of
the sprockets; the sweeps for this friction in the authors' code go to 18 rad/s, which is the limit
here.

Reference: [1] Focchi et al. (2025), sections 5.3 and 8.3.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from baselines.estimators.sensor_samples import DataSheet
from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.slip.slip_models import SlipModel
from baselines.slip.slip_sweep import identified_slip
from reproduce.focchi2025 import chicane
from reproduce.focchi2025.load_models import DURATION, FRICTION, HEIGHT
from reproduce.focchi2025.loop import follow, sampled
from reproduce.focchi2025.runs import LENGTHS, Floats, Run, vehicle
from reproduce.focchi2025.slope_identification import SPROCKET_LIMIT, model
from reproduce.focchi2025.uneven_ground import UnevenGround
from tracked_env import TERRAIN
from tracked_env.observation import make_layout
from tracked_env.physics.attitude import in_body_plane
from tracked_env.physics.parameters import PlantParameters
from tracked_env.plants.terrain_rig import TerrainRig
from tracked_env.references import ReferenceProfile, make_reference
from tracked_env.sensors import PRESETS

SPEED, TURN, RATE = 0.6, 0.4, 200.0  # [m/s], [rad/s], [Hz]
HEADINGS = (-2.9, 0.0)  # [rad] c_0, and that of the authors' code
KINDS = ("uc", "flat", "slope", "uniform")


class SlopeCase(NamedTuple):
    """A vehicle of 8.3 and its controller."""

    ground: str  # name of an UnevenGround
    kind: str  # one of KINDS
    load: str = "nonuniform"
    heading: float = HEADINGS[0]  # [rad] at the start
    length: float = LENGTHS[-1]  # [m]


class Tracking(NamedTuple):
    """Errors in the vehicle's plane, F figure 23."""

    mean: float  # [m]
    final: float  # [m]
    largest: float  # [m]
    heading: float  # [rad] largest, about the normal of the vehicle's plane
    pitch: tuple[float, float]  # [rad] least and largest, nose down


SHOWN = make_layout(TERRAIN["observation"])


def cases(grounds: Sequence[UnevenGround]) -> list[SlopeCase]:
    """What is driven: both headings on every ground; on the first one also uniform load, and the
    unicycle controller with the shorter contact length."""
    every = [
        SlopeCase(ground.name, kind, heading=heading)
        for ground in grounds
        for kind in KINDS
        for heading in HEADINGS
    ]
    first = SlopeCase(grounds[0].name, "uc")
    every += [first._replace(kind=kind, load="uniform") for kind in KINDS[:3]]
    return [*every, first._replace(length=LENGTHS[0])]


def parameters_of(length: float) -> PlantParameters:
    """Table 2 with mu = 0.6 and the faster sprockets."""
    return vehicle(length, FRICTION)._replace(sprocket_speed_limit=SPROCKET_LIMIT)


def policy(kind: str, load: str, length: float) -> SlippageAwarePolicy:
    """A controller of KINDS with the gains of F and ideal sensors."""
    parameters, period = parameters_of(length), 1.0 / RATE
    sheet = DataSheet.of(PRESETS["ideal"])
    given = (LyapunovGains(), sheet, SHOWN.names)
    if kind == "uc":
        return UnicyclePolicy(parameters, period, *given)
    slip: SlipModel = identified_slip(parameters)
    if kind != "flat":
        slip = model(load if kind == "slope" else "uniform", length)
    return SlippageAwarePolicy(parameters, period, slip, *given)


def profile(place: tuple[float, float], heading: float) -> ReferenceProfile:
    """(53) with the speeds of 8.3, from a place and heading."""
    given = chicane.REFERENCE | {"speed": SPEED, "yaw_rate": TURN}
    made = make_reference(given, DURATION, np.random.default_rng(0))
    return made._replace(x=place[0], y=place[1], yaw=heading)


def drive(grounds: Sequence[UnevenGround], asked: Sequence[SlopeCase]) -> dict[SlopeCase, Run]:
    """Drive all cases; those that differ in the heading alone as one batch."""
    by_name = {ground.name: ground for ground in grounds}
    found = {}
    for alike in dict.fromkeys(case._replace(heading=HEADINGS[0]) for case in asked):
        members = [case for case in asked if case._replace(heading=HEADINGS[0]) == alike]
        ground, parameters = by_name[alike.ground], parameters_of(alike.length)
        options = {
            "terrain": ground.field, "load": alike.load, "centre_of_mass_height": HEIGHT,
        }  # fmt: skip
        rig = TerrainRig(parameters, options, len(members))
        for row, case in enumerate(members):
            rig.stand(*ground.start, case.heading, row)
        profiles = [profile(ground.start, case.heading) for case in members]
        made = policy(alike.kind, alike.load, alike.length)
        run = follow(
            made, rig, sampled(profiles, RATE, DURATION), None, parameters, RATE, shown=SHOWN
        )
        for row, case in enumerate(members):
            found[case] = run.only(slice(row, row + 1))
    return found


def errors(run: Run) -> tuple[Floats, Floats]:
    """(T,) Cartesian error [m] and heading error [rad] in the plane of the first vehicle."""
    state, goal = run.state[:, :, 0], run.reference[:, :, 0]
    cosine, sine = np.cos(state[:, 2]), np.sin(state[:, 2])
    apart_x, apart_y = goal[:, 0] - state[:, 0], goal[:, 1] - state[:, 1]
    angles = [(np.cos(state[:, k]), np.sin(state[:, k])) for k in (8, 7)]  # pitch, roll
    ahead, left, turn = in_body_plane.py_func(
        cosine * apart_x + sine * apart_y, cosine * apart_y - sine * apart_x,
        -run.heading[:, 0], *angles,
    )  # fmt: skip
    return np.asarray(np.hypot(ahead, left)), np.asarray(turn)


def tracking(run: Run) -> Tracking:
    """Figure 23 in numbers."""
    distance, turn = errors(run)
    pitch = run.state[:, 8, 0]
    return Tracking(
        float(distance.mean()), float(distance[-1]), float(distance.max()),
        float(np.abs(turn).max()), (float(pitch.min()), float(pitch.max())),
    )  # fmt: skip
