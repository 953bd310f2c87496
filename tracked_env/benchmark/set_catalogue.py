"""The catalogue of evaluation sets: what each is drawn from.

A set is a law of vehicles, soils and changes (`tracked_env.uncertainty`), with the environment id,
the sensors, the reference and the duration of its episodes. `evaluation_sets` has those of each
frozen version, and finds sets by name.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env.observation import V0
from tracked_env.physics.parameters import PlantParameters
from tracked_env.uncertainty import Spec
from tracked_env.vehicles import SIZED

FLEET_SEED = 500_000  # of the vehicle of episode 0 of a fleet


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
        from tracked_env.uncertainty.any_vehicle import any_vehicle  # which few sets need

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
PLAN = {"kind": "plan", "goals": "halton", "planner": "dubins", "limits": {"curvature": 2.0}}
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
FAST_INDOORS = {**SPEED["reference"], "speed_range": [0.3, 0.55]}
FAST_INDOORS["lateral_acceleration_limit"] = 0.6
_BACKWARD = {"kind": "random", "speed_range": [-3.0, -1.0]}
BACKWARD_INDOORS = {**SPEED["reference"], "speed_range": [-0.5, -0.1]}
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
    planned = {**SPEED, "reference": PLAN}
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
    ("floor-reversing=friction", _MOCAP, BACKWARD_INDOORS),
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
    ("often-floors-fast=changing-floors", _BLIND_INDOORS, FAST_INDOORS),
    ("often-floors-reversing=changing-floors", _MOCAP, BACKWARD_INDOORS),
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
    ("often-hills-fast=changing-hills", _MOCAP, FAST_INDOORS),
    ("often-hills-reversing=changing-hills", _MOCAP, _BACKWARD_ON_SLOPES),
)
_OFTEN_TO_GOALS = (
    *(("often-goals=changing-floors",), ("often-goals-outages=changing-floors", _GAPS_INDOORS)),
)
OTHERS = _of_all_ids(_OUTDOORS, _INDOORS, _ON_SLOPES, _TO_GOALS)
_CHANGING = _of_all_ids(_OFTEN, _OFTEN_INDOORS, _OFTEN_ON_SLOPES, _OFTEN_TO_GOALS)
_APART = 200  # [-] seeds from the first of one set to that of the next
OFTEN = tuple(one._replace(seed=_APART * k) for k, one in enumerate(_CHANGING, start=1))
# Drawn vehicles, by what policies are told of them:
TOLD = {"": 0.0, "-10": 0.1, "-30": 0.3, "-untold": None}
_TURNS, _TURNS_INDOORS = (_RTK, _RTK, _RARE, _GAPS), (_MOCAP, _MOCAP, _RARE_INDOORS, _GAPS_INDOORS)
_DRAWN = _of_all_ids(
    [("vehicles=any-soil",)], [("floor-vehicles=any-soil",)], [("hills-vehicles=any-soil",)], []
)
FLEETS = tuple(
    one._replace(name=f"{one.name}{mark}", fleet=Fleet(error, turns))
    for one, turns in zip(_DRAWN, (_TURNS, _TURNS_INDOORS, _TURNS_INDOORS), strict=True)
    for mark, error in TOLD.items()
)
