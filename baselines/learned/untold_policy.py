"""One recurrent policy for any vehicle, driven by torques or by speeds, never told what it drives.

    u = clip(b + a y),   h', y of a gated network for x       x, a and b of `vehicle_features`
Its state is what the filter, the regressions and the network carry. It may be shown a data sheet
(length, gauge, sprocket radius, mass, inertia, torque limit), right or wrong, where it commands
torques. It sees the fields of
the layout v0, in SI; nothing of a vehicle or of a soil is a constant of it.
"""

from typing import NamedTuple

import numpy as np

from baselines.batch_policy import Array, BatchPolicy, Bools, Context, Floats
from baselines.estimators.measurement import DataSheet, arrays_of
from baselines.learned.agent_policy import Arrays
from baselines.learned.gated_network import Layers, RecurrentNetwork, layers_of
from baselines.learned.vehicle_features import FEATURES, READS, VehicleFeatures, told_of
from tracked_env import observation as layout


def policy_layers(weights: Arrays, recurrent: bool) -> Layers:
    """The network of a policy from its weights. Raises ValueError."""
    return layers_of(weights, len(FEATURES), 2, recurrent)


class AnyVehicleState(NamedTuple):
    """What it carries on, a row per vehicle each."""

    parts: tuple[Array, ...]
    hidden: Floats


class AnyVehiclePolicy(BatchPolicy[AnyVehicleState]):
    """The policy in an environment; its network commands what the environment takes. told: whether
    it is shown the vehicle of the context.

    Raises ValueError for an observation that lacks a field, and for a data sheet where it commands
    speeds.
    """

    def __init__(self, network: RecurrentNetwork, context: Context, told: bool = False) -> None:
        if told and context.drive == "speed":
            raise ValueError("told = True; a policy that commands speeds is never told its vehicle")
        self._network, self._context, self._told = network, context, told
        self._view = layout.View(context.observation, READS)
        self._last: AnyVehicleState | None = None  # that `features` is in
        self._build(1)

    def _build(self, count: int) -> None:
        sheet = DataSheet.of(self._context.sensors)
        self.features = VehicleFeatures(
            self._context.control_period, sheet, count, self._context.drive
        )
        if self._told:
            self.features.told[:] = told_of([self._context.vehicle])
        self._infer = self._network.batch(count)
        self._last = None

    def act(
        self, observation: Floats, state: AnyVehicleState | None, start: Bools
    ) -> tuple[Floats, AnyVehicleState]:
        """Sprocket torques or speeds over their limit, and the new state; a NaN of a sensor is
        skipped."""
        count = len(observation)
        if count != len(self.features.memory):
            self._build(count)
        arrays = [array for part in self.features.parts for array in arrays_of(part)]
        if state is None:
            hidden = np.zeros((count, self._network.size), dtype=np.float32)
        else:
            self.same_count(len(state.hidden), count)
            hidden = np.where(start[:, None], np.float32(0.0), state.hidden)
            if state is not self._last:
                for array, kept in zip(arrays, state.parts, strict=True):
                    array[:] = kept
        self._last = None
        seen = self.features.see(observation, start)
        action = self.features.action(self._infer(seen, hidden))
        # Copies: the caller may go on from any state.
        self._last = AnyVehicleState(tuple(array.copy() for array in arrays), hidden)
        return np.clip(action, -1.0, 1.0).astype(np.float32), self._last
