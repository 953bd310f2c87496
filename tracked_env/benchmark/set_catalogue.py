"""The evaluation sets: laws with sensors, reference, plant and duration of their episodes.

Which of them are frozen, and in which version, is in `tracked_env.benchmark.sets`; those of no
version are candidates, run where they are named. A set that is changed gets the next `version`,
and its digests are made anew; those of all other sets stay.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env.observation import V0
from tracked_env.uncertainty import Spec


class BenchmarkSet(NamedTuple):
    """Law, sensors and reference from which the episodes of one set are drawn."""

    name: str
    uncertainty: Spec  # name of the law, or a law
    about: str  # what it asks of a policy
    sensors: str | Mapping[str, Any] = "rtk"
    reference: str | Mapping[str, Any] = "random"
    duration: float = 30.0  # [s]
    env: str = TORQUE_ID
    arguments: Mapping[str, Any] = MappingProxyType({})  # further ones of the environment
    version: int = 1  # counts the changes of this set


def _indoors(name: str, uncertainty: str, about: str, **given: Any) -> BenchmarkSet:
    """A set of Speed-v0."""
    further = ("vehicle", "plant", "drive", "error_limit")
    arguments = {key: given.get(key, SPEED[key]) for key in further}
    sensors = given.get("sensors", SPEED["sensors"])
    reference = given.get("reference", SPEED["reference"])
    return BenchmarkSet(
        name, uncertainty, about, sensors, reference, 30.0, SPEED_ID, MappingProxyType(arguments)
    )


# Sets of Terrain-v0 show the heights around the vehicle too, behind the groups of the id.
_SHOWN = (*TERRAIN["observation"], "height_scan")


def _on_slopes(
    name: str,
    uncertainty: str,
    about: str,
    sensors: str | Mapping[str, Any] = TERRAIN["sensors"],
    reference: Mapping[str, Any] = TERRAIN["reference"],
) -> BenchmarkSet:
    """A set of Terrain-v0."""
    arguments = {key: TERRAIN[key] for key in ("vehicle", "plant", "drive", "error_limit")}
    arguments["observation"] = _SHOWN
    return BenchmarkSet(
        name, uncertainty, about, sensors, reference, 30.0, TERRAIN_ID,
        MappingProxyType(arguments),
    )  # fmt: skip


# Sets with a goal, which is shown too. The reference is a plan in closed form, because the last
# bits of what is searched for depend on the processor. It takes 4 to 16 s.
_PLAN = {"kind": "plan", "goals": "halton", "planner": "dubins", "limits": {"curvature": 2.0}}
_TO_GOALS = (*V0.groups, "goal")
_GOAL_TIME = 20.0  # [s]


def _to_goals(name: str, uncertainty: str, about: str, **given: Any) -> BenchmarkSet:
    """A set of Speed-v0 with goals."""
    indoors = _indoors(name, uncertainty, about, reference=_PLAN, **given)
    arguments = MappingProxyType({**indoors.arguments, "observation": _TO_GOALS})
    return indoors._replace(duration=_GOAL_TIME, arguments=arguments)


# Frozen in v2, terrain-v1 and goals-v1.
FIRST = (
    BenchmarkSet("nominal", "nominal", "nothing is unknown"),
    BenchmarkSet("soil-and-mass", "soil-and-mass", "unknown vehicle on unknown soil"),
    BenchmarkSet("payload", "payload", "the mass steps"),
    BenchmarkSet("resistance-map", "resistance-map", "the resistance varies in the plane"),
    BenchmarkSet("weak-soil", "weak-soil", "large slip, little traction"),
    BenchmarkSet("terrain-transition", "terrain-transition", "a border to another soil"),
    BenchmarkSet("drift", "drift", "everything slides away slowly"),
    BenchmarkSet("mixed", "mixed", "several changes at once"),
    BenchmarkSet("ood", "ood", "outside the ranges of all other sets"),
    # One observation does not determine the position or the velocity of the vehicle.
    BenchmarkSet(
        "late-pose", "soil-and-mass", "position, heading, velocity come 0.2 s late",
        {"preset": "rtk", "pose_delay": 0.2},
    ),
    BenchmarkSet("noisy", "soil-and-mass", "position noise of 1 m", "strawa"),
    BenchmarkSet(
        "no-velocity", "soil-and-mass", "the velocity is not measured",
        {"preset": "rtk", "velocity_measured": 0.0},
    ),
    BenchmarkSet("slow-drive", "slow-drive", "the motors lag 0.15 to 0.3 s"),
    # Another plant than any controller's model: the shear of patches under the tracks.
    BenchmarkSet(
        "distributed", "loose-soil", "patches under the tracks: model mismatch for all controllers",
        arguments=MappingProxyType({"plant": "distributed"}),
    ),
    _indoors("floor", "nominal", "nothing is unknown, indoors"),
    _indoors("friction", "friction", "unknown vehicle on an unknown floor"),
    _indoors("friction-step", "friction-step", "a border to another floor"),
    _indoors("friction-drift", "friction-drift", "the floor gets wet, or dries"),
    _indoors("floor-mixed", "floor-mixed", "another load, another floor"),
    _indoors("floor-ood", "floor-ood", "ice or soil, heavy loads, drives that lag"),
    _indoors(
        "floor-late-pose", "friction", "position, heading, velocity come 0.1 s late",
        sensors={"preset": "mocap", "pose_delay": 0.1},
    ),
    _on_slopes("level", "nominal", "nothing is unknown, level ground"),
    _on_slopes("slope", "slope", "unknown vehicle on an unknown slope"),
    _on_slopes("hills", "hills", "the same on unknown hills"),
    _on_slopes("slope-step", "slope-step", "on a slope, a border to another floor"),
    _on_slopes("soft-patches", "soft-patches", "hills with soft ground on the path"),
    _on_slopes("hills-ood", "hills-ood", "steeper hills, heavy loads, little friction"),
    _on_slopes("slope-payload", "slope-payload", "a load off the middle is put down or taken up"),
    _on_slopes(
        "hills-late-pose", "hills", "position, heading, velocity come 0.1 s late",
        sensors={"preset": "mocap", "pose_delay": 0.1},
    ),
    _to_goals("goals", "friction", "a goal to be reached on an unknown floor"),
    _to_goals("goals-step", "friction-step", "the same across a border to another floor"),
)  # fmt: skip
# The others: of v3, or candidates for it.
_RARE = {"preset": "rtk", "pose_rate": 1.0}
_LATE = {"preset": "rtk", "pose_delay": 0.2}
_BLIND_OUTAGES = {"preset": "rtk-outages", "velocity_measured": 0.0}
_PATCHES = MappingProxyType({"plant": "distributed"})
_FAST = {
    "kind": "random", "speed_range": [2.0, 5.0], "yaw_rate_limit": 0.8,
    "lateral_acceleration_limit": 3.0,
}  # fmt: skip
_BACKWARD = {"kind": "random", "speed_range": [-3.0, -1.0]}
_IN_FIELD = (
    BenchmarkSet("weak-actuator", "weak-actuator", "drives give 0.4 to 0.7 of the command"),
    BenchmarkSet("actuator-fault", "actuator-fault", "one drive loses torque on the way"),
    BenchmarkSet("alternating-gains", "alternating-gains", "other gains of the drives every 4 s"),
    BenchmarkSet("alternating", "alternating-soils", "another soil every 2 s"),
    # Outages of the pose, of 3 to 10 s; inertial and drive group stay.
    BenchmarkSet("outages", "soil-and-mass", "seconds without pose", "rtk-outages"),
    BenchmarkSet("outages-weak-soil", "weak-soil", "the same with large slip", "rtk-outages"),
    BenchmarkSet(
        "outages-alternating", "alternating-soils", "the same, another soil every 2 s",
        "rtk-outages",
    ),
    BenchmarkSet("outages-payload", "payload", "outages, and the mass steps", "rtk-outages"),
    BenchmarkSet("outages-mixed", "mixed", "outages and several changes", "rtk-outages"),
    BenchmarkSet("outages-ood", "ood", "outages outside all ranges", "rtk-outages"),
    BenchmarkSet("outages-fault", "actuator-fault", "outages, a drive fails", "rtk-outages"),
    BenchmarkSet("outages-gains", "alternating-gains", "outages, other gains", "rtk-outages"),
    BenchmarkSet("outages-no-velocity", "soil-and-mass", "outages, no velocity", _BLIND_OUTAGES),
    BenchmarkSet(
        "outages-slow-drive", "slow-drive", "outages, motors lag 0.15 to 0.3 s", "rtk-outages"
    ),
    BenchmarkSet("rare-pose", "soil-and-mass", "a pose a second", _RARE),
    BenchmarkSet("rare-pose-weak-soil", "weak-soil", "a pose a second, large slip", _RARE),
    BenchmarkSet("rare-pose-gains", "alternating-gains", "a pose a second, other gains", _RARE),
    BenchmarkSet("noisy-weak-soil", "weak-soil", "position noise of 1 m, large slip", "strawa"),
    BenchmarkSet("noisy-payload", "payload", "position noise of 1 m, the mass steps", "strawa"),
    BenchmarkSet("slow-drive-late", "slow-drive", "motors lag, the pose is 0.2 s late", _LATE),
    BenchmarkSet("late-weak-soil", "weak-soil", "the pose is 0.2 s late, large slip", _LATE),
    BenchmarkSet("late-gains", "alternating-gains", "the pose is 0.2 s late, other gains", _LATE),
    BenchmarkSet(
        "fast", "soil-and-mass", "2 to 5 m/s, near the limit of the soil", reference=_FAST
    ),
    BenchmarkSet("fast-weak-soil", "weak-soil", "the same beyond that limit", reference=_FAST),
    BenchmarkSet("fast-payload", "payload", "2 to 5 m/s, the mass steps", reference=_FAST),
    BenchmarkSet("reversing", "soil-and-mass", "backward", reference=_BACKWARD),
    BenchmarkSet(
        "outages-distributed", "loose-soil", "outages on patches", "rtk-outages",
        arguments=_PATCHES,
    ),
    BenchmarkSet(
        "distributed-alternating", "alternating-soils", "patches, another soil every 2 s",
        arguments=_PATCHES,
    ),
    BenchmarkSet(
        "distributed-slow-drive", "slow-drive", "patches, motors that lag", arguments=_PATCHES
    ),
    BenchmarkSet(
        "distributed-fast", "loose-soil", "patches, 2 to 5 m/s", reference=_FAST,
        arguments=_PATCHES,
    ),
)  # fmt: skip
_RARE_INDOORS = {"preset": "mocap", "pose_rate": 1.0}
_NOISY_INDOORS = {"preset": "mocap", "position_noise": 0.05}
_NO_VELOCITY_INDOORS = {"preset": "mocap", "velocity_measured": 0.0}
_LATE_INDOORS = {"preset": "mocap", "pose_delay": 0.1}
_FAST_INDOORS = {**SPEED["reference"], "speed_range": [0.3, 0.8], "lateral_acceleration_limit": 0.8}
_BACKWARD_INDOORS = {**SPEED["reference"], "speed_range": [-0.5, -0.1]}
_ON_FLOORS = (
    _indoors(
        "floor-outages", "friction", "seconds without pose on an unknown floor",
        sensors="mocap-outages",
    ),
    _indoors(
        "floor-outages-step", "friction-step", "the same across a border to another floor",
        sensors="mocap-outages",
    ),
    _indoors(
        "floor-outages-alternating", "alternating-floors", "the same, another floor every 3 s",
        sensors="mocap-outages",
    ),
    _indoors("floor-outages-ood", "floor-ood", "outages on ice, or soil", sensors="mocap-outages"),
    _indoors(
        "floor-outages-slow-drive", "slow-floor-drive", "outages, motors lag",
        sensors="mocap-outages",
    ),
    _indoors("floor-alternating", "alternating-floors", "another floor every 3 s"),
    _indoors("floor-slow-drive", "slow-floor-drive", "the motors lag 0.15 to 0.3 s"),
    _indoors("floor-rare-pose", "friction", "a pose a second", sensors=_RARE_INDOORS),
    _indoors(
        "floor-rare-pose-step", "friction-step", "a pose a second, a border",
        sensors=_RARE_INDOORS,
    ),
    _indoors("floor-noisy", "friction", "position noise of 5 cm", sensors=_NOISY_INDOORS),
    _indoors(
        "floor-no-velocity", "friction", "the velocity is not measured",
        sensors=_NO_VELOCITY_INDOORS,
    ),
    _indoors(
        "floor-slow-drive-late", "slow-floor-drive", "motors lag, the pose is 0.1 s late",
        sensors=_LATE_INDOORS,
    ),
    _indoors("floor-fast", "friction", "0.3 to 0.8 m/s", reference=_FAST_INDOORS),
    _indoors("floor-reversing", "friction", "backward", reference=_BACKWARD_INDOORS),
    _to_goals("goals-outages", "friction", "a goal, seconds without pose", sensors="mocap-outages"),
)  # fmt: skip
_FAST_ON_SLOPES = {**TERRAIN["reference"], "speed_range": [0.3, 0.8]}
_BACKWARD_ON_SLOPES = {**TERRAIN["reference"], "speed_range": [-0.5, -0.1]}
_UNEVEN = (
    _on_slopes("hills-outages", "hills", "seconds without pose", "mocap-outages"),
    _on_slopes("slope-outages", "slope", "the same on a plane", "mocap-outages"),
    _on_slopes("slope-step-outages", "slope-step", "outages, a border", "mocap-outages"),
    _on_slopes("soft-patches-outages", "soft-patches", "outages, soft ground", "mocap-outages"),
    _on_slopes("slope-payload-outages", "slope-payload", "outages, a load", "mocap-outages"),
    _on_slopes("hills-rare-pose", "hills", "a pose a second", _RARE_INDOORS),
    _on_slopes("slope-rare-pose", "slope", "the same on a plane", _RARE_INDOORS),
    _on_slopes("hills-noisy", "hills", "position noise of 5 cm", _NOISY_INDOORS),
    _on_slopes("hills-no-velocity", "hills", "the velocity is not measured", _NO_VELOCITY_INDOORS),
    _on_slopes("slope-step-late", "slope-step", "a border, the pose is 0.1 s late", _LATE_INDOORS),
    _on_slopes("hills-fast", "hills", "0.3 to 0.8 m/s", reference=_FAST_ON_SLOPES),
    _on_slopes("hills-reversing", "hills", "backward", reference=_BACKWARD_ON_SLOPES),
)
CATALOGUE = {each.name: each for each in (*FIRST, *_IN_FIELD, *_ON_FLOORS, *_UNEVEN)}
