"""Splits of the seeds: which episodes choose, which check, and which are published.

Episode i of an evaluation set is drawn from the seed FIRST + i of its split:
    FROZEN       the published episodes; nothing is ever chosen on them
    DEVELOPMENT  gains, settings and designs are chosen on these
    AUDIT        conclusions are checked on these, once, at the end
    OBSERVER     noise levels and gates of the estimators are chosen and confirmed on these
Trainings and their held-out episodes begin at seeds far above (`agents.training`).

The evaluation sets: laws with sensors, reference, plant and duration of their episodes.

Which of them are frozen, and in which version, is in `tracked_env.benchmark.evaluation_sets`; those of no
version are candidates, run where they are named. A set that is changed gets the next `version`,
and its digests are made anew; those of all other sets stay. Sets in FIRST are held by versions that
do not change: what is to be another one there gets another name.

The evaluation sets, in each version the same episodes for every policy.

A set is a law of vehicles, soils and changes (`tracked_env.uncertainty`), with the environment id,
the sensors, the reference and the duration of its episodes; episode i is drawn from seed SEED + i.
Digests of the first EPISODES are kept in one file per version (`Version.file`), and `frozen`
compares with them. A set belongs here if it separates policies: nominal from oracle or, in the sets
that need memory, policies of one observation from policies of many.

The sets are defined in `set_catalogue`. Those of a version are in groups, by what decides there:
    memory               what was observed before
    identification       parameters that are found under way
    mismatch             the plant is not the model of any controller
    out-of-distribution  not met in any training
To change a set of the newest versions is to count its `version` up, to make its digests anew and to
leave all others; older versions stay as they are. `register` adds a set of one's own, which is run
where it is named and belongs to no version.
"""

from collections.abc import Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env.engine.episode import Episode
from tracked_env.observation import V0
from tracked_env.physics.parameters import STATE_NAMES
from tracked_env.uncertainty import Spec
from tracked_env.validation import unknown

FROZEN = 0
DEVELOPMENT = 50_000
AUDIT = 60_000
OBSERVER = 70_000
LENGTH = 10_000  # [-] seeds of a split, at most
SPLITS = {
    "frozen": FROZEN, "development": DEVELOPMENT, "audit": AUDIT, "observer": OBSERVER
}  # fmt: skip


def seeds_of(split: str) -> range:
    """The seeds of a split. Raises ValueError for an unknown one."""
    if split not in SPLITS:
        raise unknown("split of seeds", split, SPLITS)
    return range(SPLITS[split], SPLITS[split] + LENGTH)


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
    _on_slopes("hills", "hills", "unknown vehicle on unknown hills"),
    _on_slopes("slope-step", "slope-step", "on a slope, a border to another floor"),
    _on_slopes("soft-patches", "soft-patches", "hills with soft ground on the path"),
    _on_slopes("hills-ood", "hills-ood", "steeper hills, heavy loads, little friction"),
    _on_slopes("slope-payload", "slope-payload", "a load off the middle is put down or taken up"),
    _on_slopes(
        "hills-late-pose", "hills", "position, heading, velocity come 0.1 s late",
        sensors={"preset": "mocap", "pose_delay": 0.1},
    ),
    _to_goals("goals", "friction", "a goal to be reached on an unknown floor"),
    _to_goals("goals-step", "friction-step", "a goal across a border to another floor"),
)  # fmt: skip
# The others: of v3, or candidates for it.
_RARE = {"preset": "rtk", "pose_rate": 1.0}
_LATE = {"preset": "rtk", "pose_delay": 0.2}
_LATER = {"preset": "rtk", "pose_delay": 0.5}
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
    BenchmarkSet(
        "outages-weak-soil", "weak-soil", "no pose for seconds, large slip", "rtk-outages"
    ),
    BenchmarkSet(
        "outages-alternating", "alternating-soils", "no pose for seconds, another soil every 2 s",
        "rtk-outages",
    ),
    BenchmarkSet(
        "outages-payload", "payload", "no pose for seconds, the mass steps", "rtk-outages"
    ),
    BenchmarkSet("outages-mixed", "mixed", "no pose for seconds, several changes", "rtk-outages"),
    BenchmarkSet("outages-ood", "ood", "no pose for seconds, outside all ranges", "rtk-outages"),
    BenchmarkSet(
        "outages-fault", "actuator-fault", "no pose for seconds, a weak drive", "rtk-outages"
    ),
    BenchmarkSet(
        "outages-gains", "alternating-gains", "no pose for seconds, other gains every 4 s",
        "rtk-outages",
    ),
    BenchmarkSet(
        "outages-no-velocity", "soil-and-mass", "no pose for seconds, no velocity", _BLIND_OUTAGES
    ),
    BenchmarkSet(
        "outages-slow-drive", "slow-drive", "no pose for seconds, motors lag 0.15 to 0.3 s",
        "rtk-outages",
    ),
    BenchmarkSet("rare-pose", "soil-and-mass", "a pose a second", _RARE),
    BenchmarkSet("rare-pose-weak-soil", "weak-soil", "a pose a second, large slip", _RARE),
    BenchmarkSet("rare-pose-mixed", "mixed", "a pose a second, several changes", _RARE),
    BenchmarkSet(
        "rare-pose-gains", "alternating-gains", "a pose a second, other gains every 4 s", _RARE
    ),
    BenchmarkSet("noisy-weak-soil", "weak-soil", "position noise of 1 m, large slip", "strawa"),
    BenchmarkSet("noisy-payload", "payload", "position noise of 1 m, the mass steps", "strawa"),
    BenchmarkSet(
        "noisy-gains", "alternating-gains", "position noise of 1 m, other gains every 4 s", "strawa"
    ),
    BenchmarkSet(
        "noisy-fast", "soil-and-mass", "position noise of 1 m, 2 to 5 m/s", "strawa", _FAST
    ),
    BenchmarkSet("later-pose", "soil-and-mass", "the pose is 0.5 s late", _LATER),
    BenchmarkSet("slow-drive-late", "slow-drive", "motors lag, the pose is 0.2 s late", _LATE),
    BenchmarkSet("late-weak-soil", "weak-soil", "the pose is 0.2 s late, large slip", _LATE),
    BenchmarkSet(
        "late-gains", "alternating-gains", "the pose is 0.2 s late, other gains every 4 s", _LATE
    ),
    BenchmarkSet(
        "fast", "soil-and-mass", "2 to 5 m/s, near the limit of the soil", reference=_FAST
    ),
    BenchmarkSet(
        "fast-weak-soil", "weak-soil", "2 to 5 m/s, beyond the limit of the soil", reference=_FAST
    ),
    BenchmarkSet("fast-payload", "payload", "2 to 5 m/s, the mass steps", reference=_FAST),
    BenchmarkSet("reversing", "soil-and-mass", "driven backward", reference=_BACKWARD),
    BenchmarkSet(
        "reversing-payload", "payload", "driven backward, the mass steps", reference=_BACKWARD
    ),
    BenchmarkSet(
        "outages-distributed", "loose-soil", "no pose for seconds, on patches", "rtk-outages",
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
_BACKWARD_INDOORS = {**SPEED["reference"], "speed_range": [-0.5, -0.1]}
_ON_FLOORS = (
    _indoors(
        "floor-outages", "friction", "seconds without pose on an unknown floor",
        sensors="mocap-outages",
    ),
    _indoors(
        "floor-outages-step", "friction-step", "no pose for seconds, a border to another floor",
        sensors="mocap-outages",
    ),
    _indoors(
        "floor-outages-alternating", "alternating-floors",
        "no pose for seconds, another floor every 3 s", sensors="mocap-outages",
    ),
    _indoors(
        "floor-outages-ood", "floor-ood", "no pose for seconds, ice or soil",
        sensors="mocap-outages",
    ),
    _indoors(
        "floor-outages-slow-drive", "slow-floor-drive", "no pose for seconds, motors lag",
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
    _indoors("floor-reversing", "friction", "driven backward", reference=_BACKWARD_INDOORS),
    _to_goals("goals-outages", "friction", "a goal, no pose for seconds", sensors="mocap-outages"),
)  # fmt: skip
_BACKWARD_ON_SLOPES = {**TERRAIN["reference"], "speed_range": [-0.5, -0.1]}
_UNEVEN = (
    _on_slopes("hills-outages", "hills", "seconds without pose", "mocap-outages"),
    _on_slopes("slope-outages", "slope", "no pose for seconds, on a plane", "mocap-outages"),
    _on_slopes(
        "slope-step-outages", "slope-step", "no pose for seconds, a border", "mocap-outages"
    ),
    _on_slopes(
        "soft-patches-outages", "soft-patches", "no pose for seconds, soft ground", "mocap-outages"
    ),
    _on_slopes(
        "slope-payload-outages", "slope-payload", "no pose for seconds, a load", "mocap-outages"
    ),
    _on_slopes("hills-rare-pose", "hills", "a pose a second", _RARE_INDOORS),
    _on_slopes("slope-rare-pose", "slope", "a pose a second, on a plane", _RARE_INDOORS),
    _on_slopes("hills-noisy", "hills", "position noise of 5 cm", _NOISY_INDOORS),
    _on_slopes("hills-no-velocity", "hills", "the velocity is not measured", _NO_VELOCITY_INDOORS),
    _on_slopes("slope-step-late", "slope-step", "a border, the pose is 0.1 s late", _LATE_INDOORS),
    _on_slopes("hills-reversing", "hills", "driven backward", reference=_BACKWARD_ON_SLOPES),
)
CATALOGUE = {each.name: each for each in (*FIRST, *_IN_FIELD, *_ON_FLOORS, *_UNEVEN)}


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
    sets: tuple[str, ...] = ()  # those it holds; none: of `FIRST`, all of `envs` but other sets
    groups: Mapping[str, tuple[str, ...]] = MappingProxyType({})  # of its sets, by what decides

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
_ALL_PARAMETERS = (*_SLOPE_PARAMETERS, "actuator_gain_left", "actuator_gain_right")


def in_groups(name: str, env: str, groups: Mapping[str, tuple[str, ...]]) -> Version:
    """A version of one environment id, of the sets of these groups."""
    sets = tuple(chain.from_iterable(groups.values()))
    return Version(
        name, (env,), STATE_NAMES, _ALL_PARAMETERS, _PLANAR_EPISODE, sets, MappingProxyType(groups)
    )


TORQUE_SETS = in_groups("torque-v3", TORQUE_ID, {
    "memory": ("outages-alternating", "outages-gains", "rare-pose-mixed", "noisy-gains"),
    "identification": ("alternating", "actuator-fault", "late-weak-soil", "late-gains"),
    "mismatch": ("distributed", "distributed-alternating"),
    "out-of-distribution": ("noisy-fast", "reversing-payload"),
})  # fmt: skip
SPEED_SETS = in_groups("speed-v3", SPEED_ID, {
    "memory": ("floor-outages-alternating", "floor-rare-pose-step", "floor-no-velocity",
               "goals-outages"),
    "identification": ("friction-step", "floor-mixed", "goals-step"),
    "mismatch": ("floor-slow-drive-late",),
    "out-of-distribution": ("floor-ood", "floor-reversing"),
})  # fmt: skip
TERRAIN_SETS = in_groups("terrain-v3", TERRAIN_ID, {
    "memory": ("hills-outages", "slope-payload-outages", "slope-rare-pose", "hills-noisy"),
    "identification": ("slope", "slope-step-late"),
    "mismatch": ("soft-patches", "slope-payload"),
    "out-of-distribution": ("hills-ood", "hills-reversing"),
})  # fmt: skip
# No two of them rank the policies alike, whichever policy is left out: run where it is named.
UNLIKE_SETS = in_groups("torque-unlike-v1", TORQUE_ID, {
    "memory": ("outages-no-velocity", "noisy-gains"),
    "identification": ("alternating-gains", "rare-pose-weak-soil"),
    "mismatch": ("distributed", "distributed-alternating", "distributed-slow-drive"),
    "out-of-distribution": ("fast-weak-soil", "distributed-fast", "reversing-payload"),
})  # fmt: skip
NEWEST = (TORQUE_SETS, SPEED_SETS, TERRAIN_SETS)
VERSIONS = {v.name: v for v in (*NEWEST, PLANAR, SLOPES, GOAL_REACHING, UNLIKE_SETS)}

SETS = dict(CATALOGUE)
OF_VERSION = tuple(  # names; all others come on top
    dict.fromkeys(
        (*(entry.name for entry in FIRST), *(n for v in (*NEWEST, UNLIKE_SETS) for n in v.sets))
    )
)
# In `nominal` a controller with nominal parameters knows everything: it separates nothing.
_KNOWN = ("nominal", "floor", "level")


def version_of(env: str, sets: Sequence[str] = (), name: str | None = None) -> Version | None:
    """Version of these sets of an environment id; None for an id without frozen sets.

    It is the newest one that holds all of them, else the newest of the id. name: the version
    itself, or the end of its name, such as "v2". Raises ValueError for one that the id has not.
    """
    known = [version for version in VERSIONS.values() if env in version.envs]
    if name is not None:
        for version in known:
            if name in (version.name, version.name.rpartition("-")[2]):
                return version
        raise unknown(f"version of the sets of {env}", name, [version.name for version in known])
    holding = (version for version in known if set(sets) <= set(names_of(version)))
    return next(holding, known[0] if known else None)


def names_of(version: Version) -> tuple[str, ...]:
    """Names of the sets of a version."""
    held = GOAL_REACHING.sets
    return version.sets or tuple(
        each.name for each in FIRST if each.env in version.envs and each.name not in held
    )


def group_of(name: str, version: Version) -> str:
    """The group that a version has a set in; empty where it has none."""
    return next((group for group, sets in version.groups.items() if name in sets), "")


def default_sets(env: str = TORQUE_ID, version: str | None = None) -> tuple[str, ...]:
    """Names of the sets of an environment id that are run where none is named.

    version: of the sets, as in `version_of`; None for the newest one.
    """
    found = version_of(env, (), version)
    names = () if found is None else names_of(found)
    return tuple(name for name in names if SETS[name].env == env and name not in _KNOWN)


def tuning_sets(env: str = TORQUE_ID) -> tuple[str, ...]:
    """Names of the sets of an environment id on which controllers are tuned: those of the newest
    version, without goals."""
    return tuple(
        name
        for name in default_sets(env)
        if "goal" not in SETS[name].arguments.get("observation", ())
    )


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
