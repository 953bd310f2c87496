"""The evaluation sets by name and version, and the splits of seeds.

In each version a set of the catalogue (`set_catalogue`) has the same episodes for every policy;
episode i is drawn from seed SEED + i. Digests of the first EPISODES are kept in one file per
version (`Version.file`), and `frozen` compares with them. A set belongs to a version if it
separates policies: nominal from oracle or, in the sets that need memory, policies of one
observation from policies of many.

The sets of a version are in groups, by what decides there:
    memory               what was observed before
    identification       parameters that are found under way
    mismatch             the plant is not the model of any controller
    out-of-distribution  not met in any training
Those of no version are candidates, run where they are named. To change a set of the newest versions
is to count its `version` up and to make its digests anew; sets in FIRST are held by versions that
do not change. `register` adds a set of one's own, which belongs to no version; `own_sets` has those
of a file.

Which episodes choose, which check, and which are published: those of a split have the seeds from
its first one on,
    FROZEN       the published episodes; nothing is ever chosen on them
    DEVELOPMENT  gains, settings and designs are chosen on these
    AUDIT        conclusions are checked on these, once, at the end
    OBSERVER     noise levels and gates of the estimators are chosen and confirmed on these
Trainings and their held-out episodes begin at seeds far above.
"""

from collections.abc import Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.set_catalogue import FIRST, FLEETS, OFTEN, OTHERS
from tracked_env.benchmark.set_catalogue import TOLD as TOLD
from tracked_env.benchmark.set_catalogue import BenchmarkSet as BenchmarkSet
from tracked_env.benchmark.set_catalogue import Fleet as Fleet
from tracked_env.engine.episode import Episode
from tracked_env.physics.parameters import STATE_NAMES
from tracked_env.validation import unknown

FROZEN, DEVELOPMENT, AUDIT, OBSERVER = 0, 50_000, 60_000, 70_000
LENGTH = 10_000  # [-] seeds of a split, at most
EPISODES = 100  # of each set, that are compared with those of the version, where it says no other
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
    episodes: int = EPISODES  # of each set

    @property
    def file(self) -> str:
        """Name of the file of its digests, in this package."""
        return f"sets_{self.name}.json"


def _names(text: str) -> tuple[str, ...]:
    return tuple(text.split())


_PLANAR_STATE = _names(
    "x y yaw v_x v_y yaw_rate torque_left torque_right slip_left slip_right sprocket_speed_left "
    "sprocket_speed_right effort_left effort_right acceleration_x acceleration_y yaw_acceleration"
)
_PLANAR_PARAMETERS = _names(
    "mass inertia track_gauge track_width contact_length sprocket_radius torque_limit "
    "sprocket_speed_limit drive_time_constant sprocket_inertia cohesion friction_angle "
    "shear_deformation_modulus longitudinal_resistance lateral_resistance "
    "turning_resistance_factor icr_forward"
)
_PLANAR_EPISODE = _names("parameters events profile sensors state noise_seed relief")
PLANAR = Version("v2", (TORQUE_ID, SPEED_ID), _PLANAR_STATE, _PLANAR_PARAMETERS, _PLANAR_EPISODE)
_SLOPE_PARAMETERS = _PLANAR_PARAMETERS + _names(
    "centre_of_mass_x centre_of_mass_y centre_of_mass_z roll_inertia_ratio pitch_inertia_ratio "
    "ground_stiffness_factor"
)
SLOPES = Version("terrain-v1", (TERRAIN_ID,), STATE_NAMES, _SLOPE_PARAMETERS, Episode._fields)
_GOALS = ("goals", "goals-step")
GOAL_REACHING = Version(
    "goals-v1", (SPEED_ID,), _PLANAR_STATE, _PLANAR_PARAMETERS, _PLANAR_EPISODE, _GOALS
)
_ALL_PARAMETERS = (*_SLOPE_PARAMETERS, "actuator_gain_left", "actuator_gain_right")


def in_groups(name: str, env: str, groups: Mapping[str, tuple[str, ...]]) -> Version:
    """A version of one environment id, of the sets of these groups."""
    sets = tuple(chain.from_iterable(groups.values()))
    fields = STATE_NAMES, _ALL_PARAMETERS, _PLANAR_EPISODE
    return Version(name, (env,), *fields, sets, MappingProxyType(groups))


def _in_four(name: str, env: str, *sets: str) -> Version:
    """The same in the four groups, in the order of the head of this file."""
    groups = ("memory", "identification", "mismatch", "out-of-distribution")
    return in_groups(name, env, dict(zip(groups, map(_names, sets), strict=True)))


_TORQUE_V3 = _in_four(
    *("torque-v3", TORQUE_ID),
    "outages-alternating outages-gains rare-pose-mixed noisy-gains",
    "alternating actuator-fault late-weak-soil late-gains",
    "distributed distributed-alternating",
    "noisy-fast reversing-payload",
)
_SPEED_V3 = _in_four(
    *("speed-v3", SPEED_ID),
    "floor-outages-alternating floor-rare-pose-step floor-no-velocity goals-outages",
    "friction-step floor-mixed goals-step",
    "floor-slow-drive-late",
    "floor-ood floor-reversing",
)
_TERRAIN_V3 = _in_four(
    *("terrain-v3", TERRAIN_ID),
    "hills-outages slope-payload-outages slope-rare-pose hills-noisy",
    "slope slope-step-late",
    "soft-patches slope-payload",
    "hills-ood hills-reversing",
)
# No two of them rank the policies alike, whichever policy is left out: run where it is named.
UNLIKE_SETS = _in_four(
    *("torque-unlike-v1", TORQUE_ID),
    "outages-no-velocity noisy-gains",
    "alternating-gains rare-pose-weak-soil",
    "distributed distributed-alternating distributed-slow-drive",
    "fast-weak-soil distributed-fast reversing-payload",
)
# Where knowing is worth most: what changes every few seconds, and the kinds of before beside it.
TORQUE_SETS = _in_four(
    *("torque-v4", TORQUE_ID),
    "often-outages-all often-outages-drives often-rare-pose-resistances often-noisy-loads",
    "often-drives often-late-loads often-late-resistances often-late-all",
    "patches-soils patches-loose",
    "often-fast-loads often-reversing-resistances",
)
SPEED_SETS = _in_four(
    *("speed-v4", SPEED_ID),
    "often-floors-outages often-floors-no-velocity border-rare-pose often-goals-outages",
    "often-floors often-floors-late often-goals",
    "slow-drives-late",
    "often-floors-fast often-floors-reversing ice-or-soil",
)
TERRAIN_SETS = _in_four(
    *("terrain-v4", TERRAIN_ID),
    "often-hills-outages boxes-outages often-hills-rare-pose boxes-rare-pose",
    "often-slope often-hills-late",
    "patches-on-hills boxes",
    "often-hills-fast often-hills-reversing steep-hills",
)
_FLEET_GROUPS = {
    mark or "told": tuple(one.name for one in FLEETS if one.fleet and one.fleet.error == error)
    for mark, error in TOLD.items()
}
# 100 vehicles of any size, with 4 episodes each: run where it is named.
VEHICLE_SETS = in_groups("vehicles-v1", TORQUE_ID, _FLEET_GROUPS)._replace(
    envs=(TORQUE_ID, SPEED_ID, TERRAIN_ID), episodes=400
)
NEWEST, _V3 = (TORQUE_SETS, SPEED_SETS, TERRAIN_SETS), (_TORQUE_V3, _SPEED_V3, _TERRAIN_V3)
_OTHER_VERSIONS = (*_V3, PLANAR, SLOPES, GOAL_REACHING, UNLIKE_SETS, VEHICLE_SETS)
VERSIONS = {v.name: v for v in (*NEWEST, *_OTHER_VERSIONS)}
SETS = {each.name: each for each in (*FIRST, *OTHERS, *OFTEN, *FLEETS)}
_GROUPED = (*NEWEST, *_V3, UNLIKE_SETS, VEHICLE_SETS)
OF_VERSION = {each.name for each in FIRST}.union(*(v.sets for v in _GROUPED))
# In `nominal` a controller with nominal parameters knows everything: it separates nothing.
_KNOWN = ("nominal", "floor", "level")


def version_of(env: str, sets: Sequence[str] = (), name: str | None = None) -> Version | None:
    """Version of these sets of an environment id; None for an id without frozen sets.

    It is the newest one that holds all of them, else the newest of the id. name: the version
    itself, or the end of its name, such as "v2". Raises ValueError for one that the id has not.
    """
    versions = [version for version in VERSIONS.values() if env in version.envs]
    if name is None:
        holding = (version for version in versions if {*sets} <= {*names_of(version)})
        return next(holding, versions[0] if versions else None)
    for version in versions:
        if name in (version.name, version.name.rpartition("-")[2]):
            return version
    raise unknown(f"version of the sets of {env}", name, [version.name for version in versions])


def names_of(version: Version) -> tuple[str, ...]:
    """Names of the sets of a version."""
    others = GOAL_REACHING.sets
    return version.sets or tuple(
        each.name for each in FIRST if each.env in version.envs and each.name not in others
    )


def group_of(name: str, version: Version) -> str:
    """The group that a version has a set in; empty where it has none."""
    return next((group for group, sets in version.groups.items() if name in sets), "")


def default_sets(env: str = TORQUE_ID, version: str | None = None) -> tuple[str, ...]:
    """Names of the sets of an environment id that are run where none is named.

    version: of the sets, as in `version_of`; None for the newest one.
    """
    held_by = version_of(env, (), version)
    names = () if held_by is None else names_of(held_by)
    return tuple(name for name in names if SETS[name].env == env and name not in _KNOWN)


def tuning_sets(env: str = TORQUE_ID) -> tuple[str, ...]:
    """Names of the sets on which controllers are tuned: the newest version's, without goals."""
    arguments = {name: SETS[name].arguments for name in default_sets(env)}
    return tuple(name for name, of in arguments.items() if "goal" not in of.get("observation", ()))


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
