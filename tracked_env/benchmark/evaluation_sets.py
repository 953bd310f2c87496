"""The evaluation sets, in each version the same episodes for every policy, and the splits of seeds.

A set is a law of vehicles, soils and changes (`tracked_env.uncertainty`), with the environment id,
the sensors, the reference and the duration of its episodes; episode i is drawn from seed SEED + i.
Digests of the first EPISODES are kept in one file per version (`Version.file`), and `frozen`
compares with them. A set belongs here if it separates policies: nominal from oracle or, in the sets
that need memory, policies of one observation from policies of many.

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

import numpy as np

from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env.engine.episode import Episode
from tracked_env.observation import V0
from tracked_env.physics.parameters import STATE_NAMES, PlantParameters
from tracked_env.uncertainty import Spec
from tracked_env.uncertainty.any_vehicle import any_vehicle
from tracked_env.validation import unknown
from tracked_env.vehicles import SIZED

FROZEN, DEVELOPMENT, AUDIT, OBSERVER = 0, 50_000, 60_000, 70_000
LENGTH = 10_000  # [-] seeds of a split, at most
EPISODES = 100  # of each set, that are compared with those of the version, where it says no other
FLEET_SEED = 500_000  # of the vehicle of episode 0 of a fleet
SEED = FROZEN  # of the first episode


class Fleet(NamedTuple):
    """A set of drawn vehicles (`uncertainty.any_vehicle`), each with a few episodes in turn.

    Policies are told nominal parameters of it: each of its size and drives times 1 + error or over
    that, with equal odds. The same vehicles and episodes whatever they are told.
    """

    error: float | None = 0.0  # [-] of what is told; None: policies are told the id's vehicle
    sensors: tuple[str | Mapping[str, Any], ...] = ()  # of the episodes of a vehicle, in turn

    @property
    def episodes(self) -> int:
        """Of each vehicle."""
        return len(self.sensors)

    def vehicle(self, seed: int, base: PlantParameters) -> PlantParameters:
        """The vehicle of the episode with this seed; base: of the id."""
        return any_vehicle(FLEET_SEED + seed // self.episodes, base)

    def told(self, seed: int, base: PlantParameters) -> PlantParameters:
        """What policies are told of it."""
        if self.error is None:
            return base
        true, rng = self.vehicle(seed, base), np.random.default_rng([seed // self.episodes, 1])
        signs = np.where(rng.random(len(SIZED)) < 0.5, -1.0, 1.0)
        factors = dict(zip(SIZED, ((1.0 + self.error) ** signs).tolist(), strict=True))
        return true._replace(**{name: getattr(true, name) * of for name, of in factors.items()})


class BenchmarkSet(NamedTuple):
    """Law, sensors and reference from which the episodes of one set are drawn."""

    name: str
    uncertainty: Spec  # name of the law, or a law
    sensors: str | Mapping[str, Any] = "rtk"
    reference: str | Mapping[str, Any] = "random"
    duration: float = 30.0  # [s]
    env: str = TORQUE_ID
    arguments: Mapping[str, Any] = MappingProxyType({})  # further ones of the environment
    version: int = 1  # counts the changes of this set
    seed: int = 0  # of episode 0, to which the seed of a configuration is added
    fleet: Fleet | None = None  # whose vehicles take turns; None: that of the arguments drives all


def _sets(
    env: str,
    rows: Sequence[tuple[Any, ...]],
    usual: Mapping[str, Any] = MappingProxyType({}),
    duration: float = 30.0,
    **more: Any,
) -> tuple[BenchmarkSet, ...]:
    """Sets of an id from rows: NAME=LAW of each, or the name of both, then what these sets share,
    sensors, reference and plant.

    usual: arguments that the id is registered with, where a row does not say them; more: others.
    """
    defaults: list[Any] = [usual.get("sensors", "rtk"), usual.get("reference", "random"), None]
    common = {
        key: usual[key] for key in ("vehicle", "plant", "drive", "error_limit") if key in usual
    }
    sets = []
    for names, *of in rows:
        sensors, reference, plant = [*of, *defaults[len(of) :]]
        arguments = MappingProxyType(common | more | ({"plant": plant} if plant else {}))
        for name, _, law in (each.partition("=") for each in names.split()):
            one = BenchmarkSet(name, law or name, sensors, reference, duration, env, arguments)
            sets.append(one)
    return tuple(sets)


# The reference to a goal is a plan in closed form, because the last bits of what is searched for
# depend on the processor. It takes 4 to 16 s.
_PLAN = {"kind": "plan", "goals": "halton", "planner": "dubins", "limits": {"curvature": 2.0}}
# What is shown: where there are goals, the goal too; on slopes the heights around the vehicle.
_SHOWN_TO_GOALS = (*V0.groups, "goal")
_SHOWN_ON_SLOPES = (*TERRAIN["observation"], "height_scan")
# Sensors outdoors and indoors:
_RTK, _NOISY = "rtk", "strawa"
_GAPS, _GAPS_INDOORS = "rtk-outages", "mocap-outages"  # no pose for 3 to 10 s; the others stay
_BLIND_GAPS = {"preset": _GAPS, "velocity_measured": 0.0}
_BLIND = {"preset": "rtk", "velocity_measured": 0.0}
_BLIND_INDOORS = {"preset": "mocap", "velocity_measured": 0.0}
_RARE = {"preset": "rtk", "pose_rate": 1.0}
_RARE_INDOORS = {"preset": "mocap", "pose_rate": 1.0}
_LATE = {"preset": "rtk", "pose_delay": 0.2}
_LATER = {"preset": "rtk", "pose_delay": 0.5}
_LATE_INDOORS = {"preset": "mocap", "pose_delay": 0.1}
_NOISY_INDOORS = {"preset": "mocap", "position_noise": 0.05}
_MOCAP = SPEED["sensors"]
_LIMITS = {"yaw_rate_limit": 0.8, "lateral_acceleration_limit": 3.0}
_FAST = {"kind": "random", "speed_range": [2.0, 5.0], **_LIMITS}
_FAST_INDOORS = {**SPEED["reference"], "speed_range": [0.3, 0.55]}
_FAST_INDOORS["lateral_acceleration_limit"] = 0.6
_BACKWARD = {"kind": "random", "speed_range": [-3.0, -1.0]}
_BACKWARD_INDOORS = {**SPEED["reference"], "speed_range": [-0.5, -0.1]}
_BACKWARD_ON_SLOPES = {**TERRAIN["reference"], "speed_range": [-0.5, -0.1]}
_PATCHES = "distributed"  # another plant than any controller's model: shear under the tracks

# Frozen in v2, terrain-v1 and goals-v1.
_FIRST_OUTDOORS = (
    ("nominal soil-and-mass payload resistance-map weak-soil terrain-transition drift mixed ood",),
    # One observation does not determine the position or the velocity of the vehicle.
    ("late-pose=soil-and-mass", _LATE),
    ("noisy=soil-and-mass", _NOISY),
    ("no-velocity=soil-and-mass", _BLIND),
    ("slow-drive",),
    ("distributed=loose-soil", _RTK, "random", _PATCHES),
)
_FIRST_INDOORS = (
    ("floor=nominal friction friction-step friction-drift floor-mixed floor-ood",),
    ("floor-late-pose=friction", _LATE_INDOORS),
)
_FIRST_ON_SLOPES = (
    ("level=nominal slope hills slope-step soft-patches hills-ood slope-payload",),
    ("hills-late-pose=hills", _LATE_INDOORS),
)
_FIRST_TO_GOALS = (("goals=friction goals-step=friction-step",),)


def _of_all_ids(
    outdoors: Sequence[Any],
    indoors: Sequence[Any],
    on_slopes: Sequence[Any],
    to_goals: Sequence[Any],
) -> tuple[BenchmarkSet, ...]:
    planned = {**SPEED, "reference": _PLAN}
    return (
        *_sets(TORQUE_ID, outdoors),
        *_sets(SPEED_ID, indoors, SPEED),
        *_sets(TERRAIN_ID, on_slopes, TERRAIN, observation=_SHOWN_ON_SLOPES),
        *_sets(SPEED_ID, to_goals, planned, 20.0, observation=_SHOWN_TO_GOALS),
    )


FIRST = _of_all_ids(_FIRST_OUTDOORS, _FIRST_INDOORS, _FIRST_ON_SLOPES, _FIRST_TO_GOALS)
# The others: of v3, or candidates for it.
_OUTDOORS = (
    ("weak-actuator actuator-fault alternating-gains alternating=alternating-soils",),
    (
        "outages=soil-and-mass outages-weak-soil=weak-soil "
        "outages-alternating=alternating-soils outages-payload=payload outages-mixed=mixed "
        "outages-ood=ood outages-fault=actuator-fault outages-gains=alternating-gains",
        _GAPS,
    ),
    ("outages-no-velocity=soil-and-mass", _BLIND_GAPS),
    ("outages-slow-drive=slow-drive", _GAPS),
    (
        "rare-pose=soil-and-mass rare-pose-weak-soil=weak-soil rare-pose-mixed=mixed "
        "rare-pose-gains=alternating-gains",
        _RARE,
    ),
    ("noisy-weak-soil=weak-soil noisy-payload=payload noisy-gains=alternating-gains", _NOISY),
    ("noisy-fast=soil-and-mass", _NOISY, _FAST),
    ("later-pose=soil-and-mass", _LATER),
    ("slow-drive-late=slow-drive late-weak-soil=weak-soil late-gains=alternating-gains", _LATE),
    ("fast=soil-and-mass fast-weak-soil=weak-soil fast-payload=payload", _RTK, _FAST),
    ("reversing=soil-and-mass reversing-payload=payload", _RTK, _BACKWARD),
    ("outages-distributed=loose-soil", _GAPS, "random", _PATCHES),
    (
        "distributed-alternating=alternating-soils distributed-slow-drive=slow-drive",
        _RTK,
        "random",
        _PATCHES,
    ),
    ("distributed-fast=loose-soil", _RTK, _FAST, _PATCHES),
)
_INDOORS = (
    (
        "floor-outages=friction floor-outages-step=friction-step "
        "floor-outages-alternating=alternating-floors floor-outages-ood=floor-ood "
        "floor-outages-slow-drive=slow-floor-drive",
        _GAPS_INDOORS,
    ),
    ("floor-alternating=alternating-floors floor-slow-drive=slow-floor-drive",),
    ("floor-rare-pose=friction floor-rare-pose-step=friction-step", _RARE_INDOORS),
    ("floor-noisy=friction", _NOISY_INDOORS),
    ("floor-no-velocity=friction", _BLIND_INDOORS),
    ("floor-slow-drive-late=slow-floor-drive", _LATE_INDOORS),
    ("floor-reversing=friction", _MOCAP, _BACKWARD_INDOORS),
)
_ON_SLOPES = (
    (
        "hills-outages=hills slope-outages=slope slope-step-outages=slope-step "
        "soft-patches-outages=soft-patches slope-payload-outages=slope-payload",
        _GAPS_INDOORS,
    ),
    ("hills-rare-pose=hills slope-rare-pose=slope", _RARE_INDOORS),
    ("hills-noisy=hills", _NOISY_INDOORS),
    ("hills-no-velocity=hills", _BLIND_INDOORS),
    ("slope-step-late=slope-step", _LATE_INDOORS),
    ("hills-reversing=hills", TERRAIN["sensors"], _BACKWARD_ON_SLOPES),
)
_TO_GOALS = (("goals-outages=friction", _GAPS_INDOORS),)
# Changes so often that knowing them is worth much; each set has episodes of its own.
_OFTEN = (
    ("often-drives=flickering-drive",),
    (
        "often-late-loads=alternating-loads often-late-resistances=alternating-resistances "
        "often-late-all=alternating-all",
        _LATE,
    ),
    ("often-outages-all=alternating-all often-outages-drives=flickering-drive", _GAPS),
    ("often-rare-pose-resistances=alternating-resistances", _RARE),
    ("often-noisy-loads=alternating-loads", _NOISY),
    ("patches-soils=alternating-soils patches-loose=loose-soil", _RTK, "random", _PATCHES),
    ("often-fast-loads=alternating-loads", _RTK, _FAST),
    ("often-reversing-resistances=alternating-resistances", _RTK, _BACKWARD),
)
_OFTEN_INDOORS = (
    ("often-floors=changing-floors",),
    ("often-floors-outages=changing-floors", _GAPS_INDOORS),
    ("often-floors-no-velocity=changing-floors", _BLIND_INDOORS),
    ("border-rare-pose=friction-step", _RARE_INDOORS),
    ("often-floors-late=changing-floors slow-drives-late=slow-floor-drive", _LATE_INDOORS),
    ("often-floors-fast=changing-floors", _BLIND_INDOORS, _FAST_INDOORS),
    ("often-floors-reversing=changing-floors", _MOCAP, _BACKWARD_INDOORS),
    ("ice-or-soil=floor-ood",),
)
_OFTEN_ON_SLOPES = (
    (
        "often-slope=changing-slope boxes=slope-boxes patches-on-hills=soft-patches "
        "steep-hills=hills-ood",
    ),
    ("often-hills-outages=changing-hills boxes-outages=slope-boxes", _GAPS_INDOORS),
    ("often-hills-rare-pose=changing-hills boxes-rare-pose=slope-boxes", _RARE_INDOORS),
    ("often-hills-late=changing-hills", _LATE_INDOORS),
    ("often-hills-fast=changing-hills", _MOCAP, _FAST_INDOORS),
    ("often-hills-reversing=changing-hills", _MOCAP, _BACKWARD_ON_SLOPES),
)
_OFTEN_TO_GOALS = (
    *(("often-goals=changing-floors",), ("often-goals-outages=changing-floors", _GAPS_INDOORS)),
)
_OTHERS = _of_all_ids(_OUTDOORS, _INDOORS, _ON_SLOPES, _TO_GOALS)
_NEXT = _of_all_ids(_OFTEN, _OFTEN_INDOORS, _OFTEN_ON_SLOPES, _OFTEN_TO_GOALS)
_APART = 200  # [-] seeds from the first of one set to that of the next
_NEXT = tuple(one._replace(seed=_APART * place) for place, one in enumerate(_NEXT, start=1))
# Drawn vehicles, by what policies are told of them:
TOLD = {"": 0.0, "-10": 0.1, "-30": 0.3, "-untold": None}
_TURNS, _TURNS_INDOORS = (_RTK, _RTK, _RARE, _GAPS), (_MOCAP, _MOCAP, _RARE_INDOORS, _GAPS_INDOORS)
_FLEETS = tuple(
    one._replace(name=f"{one.name}{mark}", fleet=Fleet(error, turns))
    for one, turns in zip(
        _of_all_ids(
            (("vehicles=any-soil",),), (("floor-vehicles=any-soil",),),
            (("hills-vehicles=any-soil",),), (),
        ),
        (_TURNS, _TURNS_INDOORS, _TURNS_INDOORS),
        strict=True,
    )
    for mark, error in TOLD.items()
)  # fmt: skip


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
    mark or "told": tuple(one.name for one in _FLEETS if one.fleet and one.fleet.error == error)
    for mark, error in TOLD.items()
}
# 100 vehicles of any size, with 4 episodes each: run where it is named.
VEHICLE_SETS = in_groups("vehicles-v1", TORQUE_ID, _FLEET_GROUPS)._replace(
    envs=(TORQUE_ID, SPEED_ID, TERRAIN_ID), episodes=400
)
NEWEST, _V3 = (TORQUE_SETS, SPEED_SETS, TERRAIN_SETS), (_TORQUE_V3, _SPEED_V3, _TERRAIN_V3)
_OTHER_VERSIONS = (*_V3, PLANAR, SLOPES, GOAL_REACHING, UNLIKE_SETS, VEHICLE_SETS)
VERSIONS = {v.name: v for v in (*NEWEST, *_OTHER_VERSIONS)}
SETS = {each.name: each for each in (*FIRST, *_OTHERS, *_NEXT, *_FLEETS)}
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
