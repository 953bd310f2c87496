"""Train the policy that learns slip (`baselines.learned.learned_slip`).

    python -m agents.slip_training --seed 0 --output runs/learned-slip-seed0
    python -m agents.slip_training --env Speed-v0 --seed 0 --output runs/learned-slip-floors-seed0
On slopes the teacher is the slippage-aware controller with the true friction and the true pose, and
with what then is still left of the true motion, observed over REMAINDER seconds. On level ground it
is predictive control with the true friction and pose, since it looks ahead. The network learns its
action, less that of the unicycle controller, and the motion by which the true pose error goes on,
less that of belts and gyro, from sensors alone: by a Huber loss of what is left and of its slow
parts, since a vehicle follows an error that lasts. Beside it, as an auxiliary task, parameters of
soil and vehicle. In the first round the teacher drives, disturbed, or the unicycle controller;
later more and more of the vehicles are driven by the network (DAgger).
"""

import sys
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch

from agents import regression
from agents.imitation import Disturbance, Imitation, sum_and_difference
from agents.regression import PERIOD, Episodes, Job, Regression, one_of
from baselines.batch_policy import Array, Bools, Floats
from baselines.estimators.measurement import DataSheet
from baselines.learned.agent_policy import LEARNED_SLIP
from baselines.learned.gated_network import Layers
from baselines.learned.learned_slip import (
    ACTION,
    OUTPUTS,
    UNITS,
    LearnedSlipPolicy,
    inputs_of,
    slip_layers,
)
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov.slippage_aware import LARGEST_SLIP_ANGLE, OracleSlipPolicy
from baselines.lyapunov.true_motion import TrueMotion
from baselines.predictive.sprocket_control import PredictiveOracleSlipPolicy
from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID
from tracked_env import observation as layout
from tracked_env.arrays import columns
from tracked_env.benchmark import set_catalogue as sets
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.cli.command_line import as_argument
from tracked_env.environment_ids import find_id
from tracked_env.physics.parameters import PARAMETER_NAMES
from tracked_env.vector_env import TrackedVehicleVectorEnv

SLOPES = (
    "hills", "slope", "changing-hills", "changing-hills", "changing-slope", "slope-boxes",
    "slope-boxes", "soft-patches", "slope-step", "slope-payload",
)  # fmt: skip
FLOORS = (
    "friction", "changing-floors", "changing-floors", "changing-floors", "alternating-floors",
    "friction-step", "friction-drift", "floor-mixed", "slow-floor-drive",
)  # fmt: skip
_PLAIN: dict[str, Any] = {"preset": "mocap"}
_OUTAGES = {"preset": "mocap-outages"}
_RARE, _LATE = {**_PLAIN, "pose_rate": 1.0}, {**_PLAIN, "pose_delay": 0.1}
_BLIND = {**_PLAIN, "velocity_measured": 0.0}
_FAST, _BACKWARD = {"speed_range": [0.3, 0.55]}, {"speed_range": [-0.5, -0.1]}
REMAINDER = 0.5  # [s]
TEACHER_DRIVES = (0.5, 0.4, 0.25, 0.1)  # [-] of the vehicles of a round, then the last
DISTURBED = 0.06  # [-] deviation of what disturbs the teacher, of the speed limit
SLOW = ((0.3, 2.0), (1.0, 3.0), (3.0, 4.0))  # [s] of low passes, and what they weigh
LARGEST_TARGET = 20.0  # [-]
# What the network learns to say beside: its value that is said as 0, and what is said as 1.
KNOWN = {
    "friction_angle": (0.5, 0.15), "shear_deformation_modulus": (0.002, 0.002),
    "mass": (75.0, 15.0), "longitudinal_resistance": (0.03, 0.02),
    "centre_of_mass_x": (0.0, 0.03), "centre_of_mass_y": (0.0, 0.03),
}  # fmt: skip
_TRUTH = (
    *("reference_x", "reference_y", "reference_yaw", "x", "y", "yaw", "roll", "pitch"),
    *("v_x", "v_y", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right"), *PARAMETER_NAMES,
)  # fmt: skip
_TRUTH_COLUMNS, _KNOWN = columns(_TRUTH), columns(KNOWN)
_SENT = [layout.INDEX[f"previous_action_{side}"] for side in ("left", "right")]


class Teacher(TrueMotion, OracleSlipPolicy):
    """The slippage-aware controller that is told pose and soil, and observes what it is not told.

    What the slip of the true soil leaves of the true motion, low-passed over REMAINDER, is taken
    off the demand, and added to both slip angles.
    """

    _left: Array = np.zeros((0, 3))  # of v_x [m/s], yaw rate [rad/s] and slip angle [rad]

    def observe_truth(self, truth: Any) -> None:
        """Take over pose, motion and parameters."""
        TrueMotion.observe_truth(self, truth)
        OracleSlipPolicy.observe_truth(self, truth)
        self._true = truth
        count = len(self._true_error)
        if len(self._left) != count:
            self._left = np.zeros((count, 3))

    def _law(self, error: Array, reference: Array, alpha: Array) -> Array:
        t, share = self._true, self.control_period / REMAINDER
        sprockets = np.stack([t["sprocket_speed_left"], t["sprocket_speed_right"]], axis=1)
        _, model, motion = self._slip(sprockets)
        v_x = t["v_x"]
        slow = np.abs(v_x) < law.SLOW
        angle = np.where(slow, model, np.arctan(t["v_y"] / np.where(slow, np.inf, v_x)))
        now = np.stack([v_x - motion[:, 0], t["yaw_rate"] - motion[:, 1], angle - model], axis=1)
        self._left += share * (now - self._left)
        slip, demand = np.empty((len(error), 3)), np.empty((len(error), 2))
        slip[:, 0] = alpha
        slip[:, 1], slip[:, 2] = self.reference_slip(reference)
        bound = LARGEST_SLIP_ANGLE
        slip[:, :2] = np.clip(slip[:, :2] + self._left[:, 2:], -bound, bound)
        law.laws(error, reference, slip, self.gains, demand)
        return demand - self._left[:, :2]


class LookAheadTeacher(TrueMotion, PredictiveOracleSlipPolicy):
    """Predictive control that is told pose and soil, whoever drives: it goes on from the action
    that was sent."""

    def observe_truth(self, truth: Any) -> None:
        """Take over pose and parameters."""
        TrueMotion.observe_truth(self, truth)
        PredictiveOracleSlipPolicy.observe_truth(self, truth)

    def act(self, observation: Floats, state: Any, start: Bools) -> tuple[Floats, Any]:
        """Sprocket speeds over their limit, and the new state."""
        if state is not None:
            sent = observation[:, _SENT] * layout.SCALE[_SENT] * self.geometry.limit[:, None]
            state = state._replace(driving=state.driving._replace(sprockets=sent))
        return super().act(observation, state, start)


def tell(teacher: Any, simulation: Any) -> None:
    """Show a teacher the truth of a simulation."""
    values = simulation.batch.floats[:, _TRUTH_COLUMNS]
    teacher.observe_truth(dict(zip(_TRUTH, values.T.copy(), strict=True)))


class World(NamedTuple):
    """What vehicles of an environment meet; choices by their odds."""

    arguments: dict[str, Any]
    laws: tuple[str, ...]
    sensors: tuple[tuple[float, Any], ...]  # of a job
    references: tuple[tuple[float, dict[str, Any]], ...]  # of a job, in place of those of the id
    teacher: Callable[..., Any]


WORLDS = {
    TERRAIN_ID: World(
        TERRAIN, SLOPES,
        ((0.3, _PLAIN), (0.3, _OUTAGES), (0.25, _RARE), (0.15, _LATE)),
        tuple((odds, TERRAIN["reference"] | other)
              for odds, other in ((0.6, {}), (0.2, _FAST), (0.2, _BACKWARD))),
        Teacher,
    ),
    SPEED_ID: World(
        SPEED, FLOORS,
        ((0.25, _PLAIN), (0.25, _OUTAGES), (0.15, _RARE), (0.2, _LATE), (0.15, _BLIND)),
        (
            (0.4, SPEED["reference"]), (0.2, sets.PLAN), (0.2, sets.FAST_INDOORS),
            (0.2, sets.BACKWARD_INDOORS),
        ),
        LookAheadTeacher,
    ),
}  # fmt: skip


class Scene:
    """The vehicles of a job, the policy that sees them and its teacher."""

    def __init__(self, network: Layers, job: Job, options: Any) -> None:
        self.rng = rng = np.random.default_rng(job.first)
        world = WORLDS[options.env]
        groups = [*world.arguments.get("observation", layout.V0.groups)]
        groups += ["height_scan"] if options.heights else []
        arguments = {**world.arguments, "sensors": one_of(rng, world.sensors)}
        arguments |= {"reference": one_of(rng, world.references), "observation": groups}
        arguments |= {"uncertainty": list(world.laws), "duration": regression.DURATION}
        self.env = env = TrackedVehicleVectorEnv(job.count, autoreset_mode="Disabled", **arguments)
        self.simulation = env.simulation
        sheet, names = env.simulation.settings.sensors, env.simulation.layout.names
        vehicle = env.simulation.solver.nominal
        context = PolicyContext(
            PERIOD, "sliding", sheet, drive="speed", vehicle=vehicle, observation=names
        )
        self.policy = LearnedSlipPolicy(network, context, options.heights)
        self.teacher = world.teacher(vehicle, PERIOD, DataSheet.of(sheet), observation=names)
        seeds = [*range(job.first, job.first + job.count)]
        self.observation, _ = env.reset(seed=seeds)
        self.start = np.ones(job.count, bool)
        self._state: Any = None
        self.learner: Any = None

    def teach(self) -> tuple[Floats, Array]:
        """Actions of the teacher (N, 2), and true pose errors (N, 3)."""
        tell(self.teacher, self.simulation)
        action, self._state = self.teacher.predict(self.observation, self._state, self.start)
        return action, self.teacher._true_error

    def see(self) -> tuple[Floats, Floats]:
        """Features and actions of the unicycle controller."""
        batch = self.policy._view(self.observation).copy()
        features, uc, self.learner = self.policy.see(batch, self.learner, self.start)
        return features, uc

    def step(self, action: Any) -> bool:
        """Advance all vehicles by actions (N, 2); returns whether all have ended."""
        observation, _, terminated, truncated, _ = self.env.step(action.astype(np.float32))
        self.observation, self.start = np.nan_to_num(observation), np.zeros(len(action), bool)
        return bool((terminated | truncated).all())


def drive(options: Any, initial: Layers, network: Layers | None, job: Job) -> Episodes:
    """The episodes of a job. initial: the network before the first regression, which adds 0."""
    scene = Scene(network or initial, job, options)
    count, rng, policy = job.count, scene.rng, scene.policy
    taught = rng.random(count) < TEACHER_DRIVES[min(job.round, len(TEACHER_DRIVES) - 1)]
    steps = scene.simulation.settings.max_steps
    inputs = inputs_of(options.heights)
    features = np.zeros((count, steps, inputs), np.float16)
    targets = np.zeros((count, steps, OUTPUTS + len(KNOWN)), np.float16)
    disturbance = Disturbance(rng, count, DISTURBED)
    middle, spread = np.array([*KNOWN.values()]).T
    before = np.zeros((count, 3))
    for n in range(steps):
        x, uc = scene.see()
        right, error = scene.teach()
        features[:, n] = x
        targets[:, n, :2] = bounded((right - uc) / ACTION)
        targets[:, n, OUTPUTS:] = (scene.simulation.batch.floats[:, _KNOWN] - middle) / spread
        if n > 0:
            targets[:, n - 1, 2:OUTPUTS] = bounded(policy.unknown_motion(before, error) / UNITS)
        before = error
        outputs = policy.infer(x, scene.learner.hidden)
        scene.learner = scene.learner._replace(added=outputs[:, 2:] * UNITS)
        action = uc + ACTION * outputs[:, :2]
        action[taught] = right[taught] + disturbance.next()[taught]
        if scene.step(np.clip(action, -1.0, 1.0)):
            break
    lengths = np.array(scene.simulation.steps)
    scene.env.close()
    return Episodes(features, targets, lengths)


def bounded(values: Any) -> Array:
    """Targets that no sliding vehicle makes large."""
    return np.clip(np.nan_to_num(values), -LARGEST_TARGET, LARGEST_TARGET)


class LearnedSlip(Imitation):
    """The task, see `regression.Task`."""

    columns = ("action", "motion", "slow_action", "slow_motion")
    job = 64

    def __init__(self, options: Any) -> None:
        super().__init__(options, inputs_of(options.heights), OUTPUTS, len(KNOWN), SLOW)
        self.drive = partial(drive, options, self.layers(self.network.weights()))

    def layers(self, weights: Any) -> Layers:
        """Layers of the network in the loop."""
        return slip_layers(weights, self.options.recurrent, self.options.heights)

    def left(self, y: Any, out: Any) -> Any:
        """What is left of the sum and the difference of both actions, and of the motion."""
        left = y[..., :OUTPUTS] - out
        return torch.cat([sum_and_difference(left[..., :2]), left[..., 2:]], dim=-1)

    @torch.no_grad()
    def report(self, of: Regression) -> list[float]:
        """RMS of what is left of actions and motion over that without a network on what is held
        out of the last round, as it is, and its slowest part."""
        sums = np.zeros((2, 4))
        for features, targets, lengths in of.batches(True, None, 128, last=True):
            valid = torch.arange(features.shape[0], device=of.device)[:, None] < lengths
            y = targets.float()
            out = of.best(features.float())[0]
            for row, shown in zip(sums, (out, torch.zeros_like(out)), strict=True):
                left = self.left(y, shown) * valid[..., None]
                for k, part in enumerate((left, self.low_pass(left)[-1])):
                    row[2 * k] += float((part[..., :2] ** 2).sum())
                    row[2 * k + 1] += float((part[..., 2:] ** 2).sum())
        ratio: list[float] = np.sqrt(sums[0] / np.maximum(sums[1], 1e-12)).tolist()
        return ratio

    def recipe(self) -> dict[str, Any]:
        """What an archive says of its kind."""
        o = self.options
        return {
            "augmentation": LEARNED_SLIP,
            "augmentation_options": {"recurrent": o.recurrent, "heights": o.heights},
            "environment": {"id": o.env},
            "command": " ".join(["python -m agents.slip_training", *o.words]),
        }


def parse(words: list[str]) -> Any:
    """The options of the command line."""
    parser = regression.parser_of(
        (__doc__ or "").partition("\n")[0],
        episodes=256, further=192, rounds=9, epochs=2, batch=16, chunk=75, most=640, rate=2e-3,
    )  # fmt: skip
    add = parser.add_argument
    ids = as_argument(find_id)
    add("--env", type=ids, choices=[*WORLDS], default=TERRAIN_ID, help="id of the environment")
    add("--heights", action="store_true", help="see the height scan, too")
    add("--last-epochs", type=int, default=4, help="of the last regression")
    options = parser.parse_args(words)
    if options.heights and options.env == SPEED_ID:
        parser.error("--heights on level ground; only those of Terrain-v0 differ")
    options.words = words
    return options


if __name__ == "__main__":
    options = parse(sys.argv[1:])
    regression.train(options, LearnedSlip(options))
