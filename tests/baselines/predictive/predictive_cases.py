"""Problems of the predictive controller for its tests: one vehicle, one reference, one start."""

import numpy as np

from baselines.linearizing.linearizing_law import pressed
from baselines.predictive import predictive_control as control
from baselines.predictive.predictive_control import look_ahead
from baselines.predictive.stages import PredictiveSettings, interpolation, make_work, total_cost
from baselines.predictive.tracked_prediction import STATES, drive, prediction
from tracked_env import observation as layout
from tracked_env.physics import lumped as vehicle
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import plant_parameters
from tracked_env.physics.rigid_body import LEVEL

STAGE = 0.04  # [s]
SMOOTHING = PredictiveSettings().smoothing


@loop
def model_of(p, duration, smoothing, pull_x, pull_y):
    """Prediction of a vehicle with parameters p."""
    k = pressed(vehicle.coefficients(p, False), 1.0)
    return prediction(p, k, duration, smoothing, pull_x, pull_y)


def model(smoothing=SMOOTHING, pull_x=0.0, pull_y=0.0, **changed):
    """Prediction for the nominal vehicle with some parameters changed."""
    return model_of(plant_parameters()._replace(**changed), STAGE, smoothing, pull_x, pull_y)


def observed(speed=2.0, yaw_rate=0.3, v_x=None, turn=None, count=1, **errors):
    """Observations (count, SIZE) of a steady reference; errors by the names of the fields."""
    values = {name: np.zeros(count) for name in layout.NAMES}
    for name in layout.NAMES:
        if name.startswith("reference_speed"):
            values[name] += speed
        if name.startswith("reference_yaw_rate"):
            values[name] += yaw_rate
    values["v_x"] += speed if v_x is None else v_x
    values["yaw_rate"] += yaw_rate if turn is None else turn
    for name, value in errors.items():
        values[name] += value
    return layout.pack(values).astype(np.float32)


class Problem:
    """What the controller solves in one call, with its parts in reach."""

    def __init__(self, observation, stages=30, limit=1.0, prediction=None, **settings):
        self.settings = PredictiveSettings(**{"stages": float(stages), **settings})
        self.model = model() if prediction is None else prediction
        self.work = make_work(stages)
        weights = interpolation(STAGE * np.arange(stages + 1))
        look_ahead(observation, 0, weights, LEVEL, self.model, self.work.ahead)
        efforts = self.work.ahead.efforts[:1].copy()
        _start(observation, efforts, self.work.states)
        self.bounds = np.full(2, limit)
        self.inputs = np.clip(self.work.ahead.efforts, -limit, limit)

    def step(self):
        """One Gauss-Newton step of the inputs; the largest change."""
        return control.gauss_newton(self.model, self.settings, self.work, self.inputs, self.bounds)

    def states(self, inputs):
        """States (N + 1, STATES) of the model under inputs (N, 2)."""
        states = np.zeros((len(inputs) + 1, STATES))
        states[0] = self.work.states[0]
        for k, one in enumerate(inputs):
            drive(states[k], one, self.model, states[k + 1])
        return states

    def cost(self, inputs):
        """What is minimised."""
        inputs = np.ascontiguousarray(np.reshape(inputs, (-1, 2)))
        coupling = self.settings.effort_change * (1.0 - self.model.decay) ** 2
        return _cost(self.work, self.states(inputs), inputs, self.settings, coupling)

    def gradient(self, inputs, step=1e-5):
        """Its gradient by central differences, (N, 2)."""
        out = np.empty(inputs.size)
        for k in range(inputs.size):
            change = np.zeros(inputs.size)
            change[k] = step
            ahead, behind = (self.cost(inputs.reshape(-1) + s * change) for s in (1.0, -1.0))
            out[k] = (ahead - behind) / (2.0 * step)
        return out.reshape(inputs.shape)


@loop
def _start(observation, efforts, states):
    control.start_state(observation, 0, efforts, states)


@loop
def _cost(work, states, inputs, settings, coupling):
    return total_cost(work, states, inputs, settings, coupling)
