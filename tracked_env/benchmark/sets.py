"""The evaluation sets, in each version the same episodes for every policy.

A set is a law of vehicles, soils and changes (`tracked_env.uncertainty`), with the environment id,
the sensors, the reference and the duration of its episodes; episode i is drawn from seed SEED + i.
Digests of the first EPISODES are kept in one file per version (`Version.file`), and `frozen`
compares with them. A set belongs here if it separates policies: nominal from oracle or, in the sets
that need memory, policies of one observation from policies of many.

To change anything here, or in what is drawn, is to make a new version of the sets of that
environment. `register` adds a set of one's own, which is run where it is named and belongs to no
version.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.splits import FROZEN
from tracked_env.engine.episode import Episode
from tracked_env.observation import V0
from tracked_env.physics.state import STATE_NAMES
from tracked_env.uncertainty import Spec

EPISODES = 100  # of each set, that are compared with those of the version
SEED = FROZEN  # of the first episode


class Version(NamedTuple):
    """Frozen sets of one or more environment ids, whose digests lie in one file.

    The digests take in some fields of state, parameters and episode; later ones are not drawn in
    its sets, or have no effect on their plants.
    """

    name: str
    envs: tuple[str, ...]
    state_fields: tuple[str, ...]
    parameter_fields: tuple[str, ...]
    episode_fields: tuple[str, ...]
    sets: tuple[str, ...] = ()  # those it holds; none: all of `envs` that no other version holds

    @property
    def file(self) -> str:
        """Name of the file of its digests, in this package."""
        return f"sets_{self.name}.json"


_PLANAR_STATE = (
    "x", "y", "yaw", "v_x", "v_y", "yaw_rate", "torque_left", "torque_right", "slip_left",
    "slip_right", "sprocket_speed_left", "sprocket_speed_right", "effort_left", "effort_right",
    "acceleration_x", "acceleration_y", "yaw_acceleration",
)  # fmt: skip
_PLANAR_PARAMETERS = (
    "mass", "inertia", "track_gauge", "track_width", "contact_length", "sprocket_radius",
    "torque_limit", "sprocket_speed_limit", "drive_time_constant", "sprocket_inertia", "cohesion",
    "friction_angle", "shear_deformation_modulus", "longitudinal_resistance",
    "lateral_resistance", "turning_resistance_factor", "icr_forward",
)  # fmt: skip
_PLANAR_EPISODE = (
    "parameters", "events", "profile", "sensors", "state", "noise_seed", "relief",
)  # fmt: skip
PLANAR = Version("v2", (TORQUE_ID, SPEED_ID), _PLANAR_STATE, _PLANAR_PARAMETERS, _PLANAR_EPISODE)
_SLOPE_PARAMETERS = (
    *_PLANAR_PARAMETERS, "centre_of_mass_x", "centre_of_mass_y", "centre_of_mass_z",
    "roll_inertia_ratio", "pitch_inertia_ratio", "ground_stiffness_factor",
)  # fmt: skip
SLOPES = Version("terrain-v1", (TERRAIN_ID,), STATE_NAMES, _SLOPE_PARAMETERS, Episode._fields)
GOAL_REACHING = Version(
    "goals-v1", (SPEED_ID,), _PLANAR_STATE, _PLANAR_PARAMETERS, _PLANAR_EPISODE,
    ("goals", "goals-step"),
)  # fmt: skip
VERSIONS = {version.name: version for version in (PLANAR, SLOPES, GOAL_REACHING)}


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
    name: str, uncertainty: str, about: str, sensors: str | Mapping[str, Any] = TERRAIN["sensors"]
) -> BenchmarkSet:
    """A set of Terrain-v0."""
    arguments = {key: TERRAIN[key] for key in ("vehicle", "plant", "drive", "error_limit")}
    arguments["observation"] = _SHOWN
    return BenchmarkSet(
        name, uncertainty, about, sensors, TERRAIN["reference"], 30.0, TERRAIN_ID,
        MappingProxyType(arguments),
    )  # fmt: skip


# Sets with a goal, which is shown too. The reference is a plan in closed form, because the last
# bits of what is searched for depend on the processor. It takes 4 to 16 s.
_PLAN = {"kind": "plan", "goals": "halton", "planner": "dubins", "limits": {"curvature": 2.0}}
_TO_GOALS = (*V0.groups, "goal")
_GOAL_TIME = 20.0  # [s]


def _to_goals(name: str, uncertainty: str, about: str) -> BenchmarkSet:
    """A set of Speed-v0 with goals."""
    indoors = _indoors(name, uncertainty, about, reference=_PLAN)
    arguments = MappingProxyType({**indoors.arguments, "observation": _TO_GOALS})
    return indoors._replace(duration=_GOAL_TIME, arguments=arguments)


_ALL = (
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
# Of no version, run where they are named.
_BESIDE = (
    BenchmarkSet("weak-actuator", "weak-actuator", "drives give 0.4 to 0.7 of the command"),
    BenchmarkSet("actuator-fault", "actuator-fault", "one drive loses torque on the way"),
    # Outages of the pose, of 3 to 10 s; inertial and drive group stay.
    BenchmarkSet("outages", "soil-and-mass", "seconds without pose", "rtk-outages"),
    BenchmarkSet("outages-weak-soil", "weak-soil", "the same with large slip", "rtk-outages"),
    BenchmarkSet(
        "outages-alternating", "alternating-soils", "the same, another soil every 2 s",
        "rtk-outages",
    ),
    _indoors(
        "floor-outages", "friction", "seconds without pose on an unknown floor",
        sensors="mocap-outages",
    ),
)  # fmt: skip
SETS = {entry.name: entry for entry in _ALL}
OF_VERSION = tuple(SETS)  # names; all others come on top
SETS |= {entry.name: entry for entry in _BESIDE}
# In `nominal` a controller with nominal parameters knows everything: it separates nothing.
_KNOWN = ("nominal", "floor", "level")
_HELD = tuple(name for version in VERSIONS.values() for name in version.sets)  # by name


def version_of(env: str, sets: Sequence[str] = ()) -> Version | None:
    """Version of these sets of an environment id; None for an id without frozen sets.

    Where they are of several versions, or none is named, it is that of the most of the id's sets.
    """
    for version in VERSIONS.values():
        if sets and set(sets) <= set(version.sets):
            return version
    return next((version for version in VERSIONS.values() if env in version.envs), None)


def names_of(version: Version) -> tuple[str, ...]:
    """Names of the sets of a version."""
    return version.sets or tuple(
        name for name in OF_VERSION if SETS[name].env in version.envs and name not in _HELD
    )


def default_sets(env: str = TORQUE_ID) -> tuple[str, ...]:
    """Names of the sets of an environment id that are run where none is named."""
    return tuple(n for n in OF_VERSION if SETS[n].env == env and n not in (*_KNOWN, *_HELD))


def tuning_sets(env: str = TORQUE_ID) -> tuple[str, ...]:
    """Names of the sets of an environment id on which controllers are tuned: all that separate
    policies, of a version or not, without goals."""
    beside = tuple(entry.name for entry in _BESIDE if entry.env == env)
    return default_sets(env) + beside


def register(entry: BenchmarkSet) -> BenchmarkSet:
    """Add a set, from then on a name for `BenchmarkConfig(sets=...)`; returns it.

    Raises ValueError for a name that is taken.
    """
    if entry.name in SETS:
        raise ValueError(f"evaluation set {entry.name!r} is registered already")
    SETS[entry.name] = entry
    return entry


DEFAULT_SETS = default_sets()


def of_version(episode: Episode, version: Version) -> tuple[Any, ...]:
    """All that an episode is, as the version knows it."""
    state = tuple(getattr(episode.state, name) for name in version.state_fields)
    parameters = tuple(getattr(episode.parameters, name) for name in version.parameter_fields)
    known = episode._replace(state=state, parameters=parameters)  # type: ignore[arg-type]
    return tuple(getattr(known, name) for name in version.episode_fields)
