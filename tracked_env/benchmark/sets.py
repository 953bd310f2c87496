"""The evaluation sets, in each version the same episodes for every policy.

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

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.set_catalogue import CATALOGUE, FIRST, BenchmarkSet
from tracked_env.benchmark.splits import FROZEN
from tracked_env.engine.episode import Episode
from tracked_env.physics.state import STATE_NAMES
from tracked_env.validation import unknown

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
