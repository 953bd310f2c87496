"""The parts of the adaptive baseline, each taken out alone: policies for the study `ablation`.

A parameter that is held at its nominal value is so for the control law alone: the estimators go on,
and tell one another what they identify. The turning regression identifies m mu_t; its mu_t, over
the mass that is identified, meets a nominal mass in the law, and the force in the law is wrong by
as much as the mass. `inertial mass nominal` takes that out of it: forces stay as identified.
"""

import hashlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from baselines.estimators.interacting_models import PLAIN
from baselines.estimators.measurement import POSE, DataSheet
from baselines.estimators.stack import Identification, IdentificationStack
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from reproduce.strawa2021.identification import FORGETTING, PaperStack
from tracked_env.benchmark.files import source_fingerprint
from tracked_env.benchmark.policy_interface import PolicyContext, PolicyEntry
from tracked_env.physics.parameters import PARAMETER_INDEX, PARAMETER_NAMES

OUTAGE = 1.5  # [s] age of the pose from which on it is an outage; some sets have one pose a second
RESISTANCES = ("longitudinal_resistance", "lateral_resistance")
DRIVES = ("drive_time_constant", "actuator_gain_left", "actuator_gain_right")
SOIL = ("cohesion", "friction_angle", "shear_deformation_modulus")
_MASS = PARAMETER_INDEX["mass"]
_RESISTANCES, _DRIVES = ([PARAMETER_INDEX[name] for name in of] for of in (RESISTANCES, DRIVES))


class NominalGroundStack(IdentificationStack):
    """Its filter allows for the nominal soil in outages, as uncertain as before any data."""

    def update(self, *arguments: Any, **options: Any) -> Identification:
        """As IdentificationStack.update."""
        step = super().update(*arguments, **options)
        soil, covariance, _ = self._ground
        friction = step.parts.answers["turning"]["value"][:, 1]
        self.slip.take_ground(soil, covariance, friction)
        return step


class NoSideslipStack(IdentificationStack):
    """Without the equation of the side slip."""

    uses_sideslip = False


class SingleModelStack(NoSideslipStack):
    """One model in each regression, with its forgetting factor; without the interacting models
    there is no monitor of trends, no gate of outliers, and no equation of the side slip."""

    forgetting: float | None = None  # another factor

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        for regression in (self.longitudinal, self.turning):
            factor = self.forgetting or regression.prior.forgetting
            regression.table = PLAIN
            regression.prior = regression.prior._replace(forgetting=factor)


class ForgetfulStack(SingleModelStack):
    """The same with the forgetting factor of the paper."""

    forgetting = FORGETTING


class InertialMassPolicy(AdaptivePolicy):
    """The mass of the law is nominal, the forces m mu_l g and m mu_t g are as identified."""

    def _adapt(self, step: Identification) -> None:
        super()._adapt(step)
        parameters, nominal = self.controller.parameters, self.parameters.mass
        parameters[_RESISTANCES] *= parameters[_MASS] / nominal
        parameters[_MASS] = nominal


class OutagePolicy(AdaptivePolicy):
    """In an outage of the pose gains and lag of the drives stay what they were when it began."""

    def _adapt(self, step: Identification) -> None:
        before = self.controller.parameters[_DRIVES]
        super()._adapt(step)
        parameters, silent = self.controller.parameters, step.reading.latest.age[:, POSE] > OUTAGE
        parameters[_DRIVES] = np.where(silent, before, parameters[_DRIVES])


class Part(NamedTuple):
    """The adaptive policy without one of its parts."""

    kind: type[AdaptivePolicy] = AdaptivePolicy
    stack: type[IdentificationStack] = IdentificationStack
    held: tuple[str, ...] = ()  # parameters that are nominal for the law
    options: Mapping[str, Any] = MappingProxyType({})  # further arguments of `kind`


PARTS = {
    "all nominal": Part(held=("mass", "inertia", *RESISTANCES, *DRIVES, *SOIL)),
    "resistances nominal": Part(held=RESISTANCES),
    "motion resistance nominal": Part(held=RESISTANCES[:1]),
    "lateral resistance nominal": Part(held=RESISTANCES[1:]),
    "no filter": Part(options={"filtered": False}),
    "drives nominal": Part(held=DRIVES),
    "lag of the drives nominal": Part(held=DRIVES[:1]),
    "gains of the drives nominal": Part(held=DRIVES[1:]),
    "drives held in outages": Part(OutagePolicy),
    "mass nominal": Part(held=("mass",)),
    "inertial mass nominal": Part(InertialMassPolicy),
    "inertia nominal": Part(held=("inertia",)),
    "no soil in the law": Part(options={"uses_soil": False}),
    "no soil estimator": Part(stack=NominalGroundStack, options={"uses_soil": False}),
    "no side-slip row": Part(stack=NoSideslipStack),
    "single model": Part(stack=SingleModelStack),
    "single model, forgets faster": Part(stack=ForgetfulStack),
    "regressions of the paper": Part(stack=PaperStack),
    "filter of filterpy": Part(options={"slip": "filterpy"}),
}


def make_without(name: str, context: PolicyContext) -> AdaptivePolicy:
    """A fresh adaptive policy without a part of PARTS."""
    part, sheet = PARTS[name], DataSheet.of(context.sensors)
    arguments = context.vehicle, context.control_period, sheet, context.lateral
    kind: Any = type(part.kind.__name__, (part.kind,), {"stack_kind": part.stack})
    policy: AdaptivePolicy = kind(*arguments, observation=context.observation, **part.options)
    if part.held:
        policy.fixed_parameters = np.full((len(PARAMETER_NAMES), 1), np.nan)
        for parameter in part.held:
            nominal = getattr(context.vehicle, parameter)
            policy.fixed_parameters[PARAMETER_INDEX[parameter]] = nominal
    return policy


def entries_without(names: Sequence[str]) -> list[PolicyEntry]:
    """The policies without these parts, for the benchmark."""
    own = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:12]
    mark = "-".join([own, *map(source_fingerprint, ("baselines", "reproduce"))])
    return [PolicyEntry(name, partial(make_without, name), mark) for name in names]
