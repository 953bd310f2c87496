"""Train the policy for any vehicle (`baselines.learned.untold_policy`).

    python -m agents.untold_training --seed 0 --output runs/any-vehicle-seed0
    python -m agents.untold_training --env Speed-v0 --seed 0 --output runs/any-vehicle-floors-seed0
The teacher is predictive control with the true parameters and the true motion of every vehicle,
which differ in each episode, as `any-vehicle` draws them; the policy is to drive as one that knows
its vehicle. The network learns the teacher's action from sensors alone, by a Huber loss in units of
the vehicle's weight, of the sum and the difference of both sides and of their slow parts: a vehicle
follows an error that lasts. Beside it, as an auxiliary task, the logarithms of the vehicle's
parameters. In the first round the teacher drives, disturbed, or the action to begin with; later
more and more of the vehicles are driven by the network (DAgger), with the mean of its weights of
late. Half of the vehicles show their data sheet, with an error in most.

By speed all vehicles of a job are one, drawn or that of Speed-v0, since the teacher needs tables of
its slip (`slip_training.LookAheadTeacher`); the network learns what the teacher commands beyond the
action to begin with, and sees no data sheet.
"""

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch

from agents import imitation, regression, slip_training
from agents.driven_episodes import LAWS
from agents.imitation import Disturbance, Imitation, sum_and_difference
from agents.regression import PERIOD, Episodes, Job, Regression, one_of
from agents.slip_training import WORLDS, LookAheadTeacher, bounded, tell
from baselines.batch_policy import body_errors
from baselines.estimators.measurement import DataSheet
from baselines.learned.agent_policy import ANY_VEHICLE
from baselines.learned.gated_network import BatchNetwork, Layers
from baselines.learned.untold_policy import policy_layers
from baselines.learned.vehicle_features import FEATURES, TOLD, VehicleFeatures, told_of
from baselines.linearizing.oracle_policy import LOADS, use_equivalents
from baselines.lyapunov.slippage_aware import KnownSlip
from baselines.predictive.predictive_control import PredictiveController
from baselines.predictive.sprocket_control import settings_for
from baselines.predictive.stages import PredictiveSettings
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env import observation as layout
from tracked_env.arrays import columns
from tracked_env.cli.command_line import as_argument
from tracked_env.environment_ids import find_id
from tracked_env.physics.parameters import PARAMETER_NAMES, VEHICLES, PlantParameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.uncertainty.any_vehicle import any_vehicle
from tracked_env.vector_env import TrackedVehicleVectorEnv

# What the network learns to say beside the action, and what it says as 0 [SI]; half a logarithm.
KNOWN = {
    "contact_length": 2.0, "track_gauge": 1.6, "sprocket_radius": 0.25, "mass": 2000.0,
    "inertia": 2000.0, "torque_limit": 5000.0, "drive_time_constant": 0.06,
    "longitudinal_resistance": 0.1, "lateral_resistance": 0.45,
    "actuator_gain_left": 1.0, "actuator_gain_right": 1.0,
}  # fmt: skip
KNOWN_BY_SPEED = {
    "contact_length": 2.0, "track_gauge": 1.6, "sprocket_radius": 0.25,
    "sprocket_speed_limit": 15.0, "drive_time_constant": 0.06, "friction_angle": 0.5,
    "shear_deformation_modulus": 0.01, "longitudinal_resistance": 0.1,
}  # fmt: skip
LEAST = 1e-3  # [SI] of a value whose logarithm is shown
# By speed: share of the jobs that have a drawn vehicle; moduli over the nominal one and frictions
# [-] of the tables that its teacher has, around what `any-soil` draws.
DRAWN = 0.7
MODULI, FRICTIONS = (0.5, 1.0, 2.0), (0.4, 0.6, 0.95)
JOB_BY_SPEED = 16  # [episodes] driven together
BUDGET_BY_SPEED = {
    "episodes": 256, "further": 192, "rounds": 8, "epochs": 2, "batch": 16, "chunk": 75,
    "most": 640, "rate": 2e-3, "last_epochs": 3,
}  # fmt: skip
_LIMITS = {"yaw_rate_limit": 0.8, "lateral_acceleration_limit": 3.0}
REFERENCES: tuple[tuple[float, Any], ...] = (  # odds
    (0.45, "random"),
    (0.15, {"kind": "random", "speed_range": [2.0, 5.0], **_LIMITS}),
    (0.15, {"kind": "random", "speed_range": [-3.0, -1.0]}),
    (0.1, "mixed"),
    (0.15, "figure_eight"),
)
# Drawn vehicles, or the one of the id, whose loads, resistances and drives change often
SPECS: tuple[tuple[float, Any], ...] = ((0.75, "any-vehicle"), (0.25, list(LAWS)))
PLANTS = ((0.85, "lumped"), (0.15, "distributed"))
NOISES = ((0.75, "rtk"), (0.1, "strawa"), (0.15, "no-velocity"))  # of all vehicles of a job
OUTAGES: dict[str, Any] = {"pose_outage_gap": (5.0, 10.0), "pose_outage_length": (3.0, 10.0)}
TEACHER = PredictiveSettings(
    position=100.0, heading=3.6, speed=2.7, yaw_rate=0.23, effort=1.1, effort_change=76.0,
    terminal=3.6, traction=0.96, smoothing=1.0,
)  # fmt: skip
ROUNDED = {  # settings of `PredictiveSettings.for_pace` go to the nearest of these
    "position": TEACHER.position * np.array([1.0, 1.5, 2.2, 3.5]),
    "heading": TEACHER.heading * np.array([1.0, 3.0, 6.0, 12.0, 24.0]),
    "duration": np.array([0.04, 0.05, 0.06]),
}
SHEET_ERRORS = (0.0, 0.1, 0.3)  # [-] with equal odds
TEACHER_DRIVES = (0.5, 0.6, 0.45, 0.3, 0.2, 0.1)  # [-] of the vehicles of a round, then the last
DISTURBED = 0.15  # [-] deviation of what disturbs the teacher, of the torque limit
SHARP = 10.0  # [-] the loss is square below a tenth of the weight

_POSES = ("reference_x", "reference_y", "reference_yaw", "x", "y", "yaw", "v_x", "v_y", "yaw_rate")
_MOTION, _TRUE, _LOADS = columns(_POSES), columns(PARAMETER_NAMES), columns(LOADS)
_SHOWN = ("position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate")
_COLUMNS = [layout.INDEX[name] for name in _SHOWN]
_SCALES = layout.SCALE[_COLUMNS]
_UNUSED = [
    layout.INDEX[n] for n in layout.NAMES if n.startswith(("acc", "yaw_acc", "sprocket", "torque"))
]


def sensors_of(noise: str) -> Any:
    """Sensors of all vehicles of a job."""
    return {"preset": "rtk", "velocity_measured": 0.0} if noise == "no-velocity" else noise


def turns_of(rng: np.random.Generator, count: int, noise: str) -> list[Any]:
    """What further differs: a plain pose, a rare or a late one, or outages."""
    rows = []
    for k in range(count):
        own: dict[str, Any] = {}
        if k % 4 == 1:
            own = {"pose_rate": float(rng.choice([1.0, 1.0, 2.0, 5.0]))}
        elif k % 4 == 2:
            own = OUTAGES
        elif k % 8 == 3:
            own = {"pose_delay": float(rng.choice([0.1, 0.2, 0.3]))}
        base = sensors_of(noise)
        whole = base if isinstance(base, dict) else {"preset": base}
        rows.append({"sensors": {**whole, **own}})
    return rows


def rounded(settings: PredictiveSettings) -> PredictiveSettings:
    """Settings that many vehicles share: each the nearest of ROUNDED on a logarithmic scale."""
    own = {n: of[np.argmin(np.abs(np.log(of / getattr(settings, n))))] for n, of in ROUNDED.items()}
    return settings._replace(**own)


class Teacher:
    """Predictive control of vehicles that differ, each with its true parameters."""

    def __init__(self, vehicles: list[PlantParameters], distributed: bool) -> None:
        # Vehicles of about the same settings are one group.
        groups: dict[PredictiveSettings, list[int]] = {}
        for row, p in enumerate(vehicles):
            groups.setdefault(rounded(TEACHER.for_pace(p)), []).append(row)
        self._groups = [
            (np.array(rows), PredictiveController(vehicles[rows[0]], PERIOD, of))
            for of, rows in groups.items()
        ]
        self._plans: list[Any] = [None] * len(self._groups)
        self._given = np.zeros((len(vehicles), 2))
        self._distributed = distributed

    def act(self, observation: Any, floats: Any, start: Any) -> Any:
        """Actions (N, 2); floats: the rows of the simulation."""
        values = floats[:, _MOTION]
        errors = body_errors(values[:, :3].T, *values[:, 3:6].T)
        seen = np.nan_to_num(observation)
        seen[:, _COLUMNS] = np.stack([*errors, *values[:, 6:].T], axis=1) / _SCALES
        seen[:, _UNUSED] = 0.0
        parameters = np.ascontiguousarray(floats[:, _TRUE].T)
        if self._distributed:
            use_equivalents(np.ascontiguousarray(floats[:, _LOADS].T), parameters)
        actions = np.zeros((len(values), 2))
        for g, (rows, controller) in enumerate(self._groups):
            controller.parameters = np.ascontiguousarray(parameters[:, rows])
            given = self._given[rows]
            actions[rows], self._plans[g] = controller.act(
                np.ascontiguousarray(seen[rows]), self._plans[g], start[rows], given
            )
            self._given[rows] = given
        return actions


def sheets(rng: np.random.Generator, vehicles: list[PlantParameters]) -> Any:
    """What half of them are told, (N, 1 + TOLD); the others zeros."""
    told = np.zeros((len(vehicles), 1 + len(TOLD)))
    shown = told_of(vehicles)
    errors = rng.choice(SHEET_ERRORS, size=(len(vehicles), 1))
    signs = rng.choice([-1.0, 1.0], size=(len(vehicles), len(TOLD)))
    shown[:, 1:] += 0.5 * signs * np.log1p(errors)
    half = rng.random(len(vehicles)) < 0.5
    told[half] = shown[half]
    return told


class Scene:
    """The vehicles of a job at the start of their episodes, what the policy sees of them, and their
    teacher."""

    known: Mapping[str, float] = KNOWN
    disturbed = DISTURBED
    slow: Sequence[tuple[float, float]] = imitation.SLOW

    def __init__(self, job: Job) -> None:
        rng = np.random.default_rng(job.first)
        noise, plant = one_of(rng, NOISES), one_of(rng, PLANTS)
        arguments = {
            "uncertainty": one_of(rng, SPECS),
            "sensors": sensors_of(noise),
            "reference": one_of(rng, REFERENCES),
            "plant": plant,
        }
        self._begin(job, rng, arguments, {"rows": turns_of(rng, job.count, noise)})
        vehicles = [self.simulation.nominal(i) for i in range(job.count)]
        self.seen.told[:] = sheets(rng, vehicles)
        self._teacher: Any = Teacher(vehicles, plant == "distributed")

    def _begin(self, job: Job, rng: Any, arguments: dict[str, Any], options: Any) -> None:
        self.rng, more = rng, {"duration": regression.DURATION, "autoreset_mode": "Disabled"}
        self.env = TrackedVehicleVectorEnv(job.count, **arguments, **more)
        self.simulation = self.env.simulation
        seeds = [*range(job.first, job.first + job.count)]
        self.observation, _ = self.env.reset(seed=seeds, options=options)
        self.sheet = DataSheet.of(self.simulation.settings.sensors)
        drive = arguments.get("drive", "torque")
        self.seen = VehicleFeatures(PERIOD, self.sheet, job.count, drive)
        self.start = np.ones(job.count, bool)

    def teach(self) -> Any:
        """Actions (N, 2) of the teacher."""
        return self._teacher.act(self.observation, self.floats, self.start)

    def target(self, right: Any) -> Any:
        """What the network is to say (N, 2), and what it is worth (N, 1): over the weight."""
        mass, limit, radius = (
            self.floats[:, columns((name,))] for name in ("mass", "torque_limit", "sprocket_radius")
        )
        return np.concatenate([right, limit / (radius * mass * GRAVITY)], axis=1)

    @property
    def floats(self) -> Any:
        """The rows of the simulation."""
        return self.simulation.batch.floats

    def step(self, action: Any) -> bool:
        """Advance all vehicles by actions (N, 2); returns whether all have ended."""
        action = np.clip(action, -1.0, 1.0).astype(np.float32)
        observation, _, terminated, truncated, _ = self.env.step(action)
        self.observation, self.start = np.nan_to_num(observation), np.zeros(len(action), bool)
        return bool((terminated | truncated).all())


class SpeedScene(Scene):
    """The same by speed; all vehicles of a job are one."""

    known = KNOWN_BY_SPEED
    disturbed, slow = slip_training.DISTURBED, slip_training.SLOW

    def __init__(self, job: Job) -> None:
        rng, world = np.random.default_rng(job.first), WORLDS[SPEED_ID]
        vehicle, soils, model = VEHICLES["focchi"], list(world.laws), None
        references: Any = world.references
        if rng.random() < DRAWN:
            vehicle, soils = any_vehicle(job.first, vehicle), ["any-soil"]
            # Plans to goals are those of the room of Speed-v0.
            usual = world.arguments["reference"]
            references = [(odds, usual if r["kind"] == "plan" else r) for odds, r in references]
            model = KnownSlip(vehicle, False, MODULI, FRICTIONS)
        arguments = {
            **world.arguments, "vehicle": vehicle, "uncertainty": soils,
            "sensors": one_of(rng, world.sensors), "reference": one_of(rng, references),
        }  # fmt: skip
        self._begin(job, rng, arguments, None)
        names, settings = self.simulation.layout.names, settings_for(vehicle)
        self._teacher = LookAheadTeacher(
            vehicle, PERIOD, self.sheet, model=model, observation=names, settings=settings
        )
        self._state: Any = None

    def teach(self) -> Any:
        """Actions (N, 2) of the teacher."""
        tell(self._teacher, self.simulation)
        action, self._state = self._teacher.predict(self.observation, self._state, self.start)
        return action

    def target(self, right: Any) -> Any:
        """What the network is to say (N, 2), beyond the action to begin with, and what it is
        worth (N, 1): the same everywhere."""
        own = bounded((right - self.seen.begin) / self.seen.unit)
        return np.concatenate([own, np.full((len(own), 1), 1.0 / SHARP)], axis=1)


SCENES = {TORQUE_ID: Scene, SPEED_ID: SpeedScene}


def known_of(floats: Any, known: Mapping[str, float] = KNOWN) -> Any:
    """`known` of the rows of a simulation, (N, K)."""
    values = np.maximum(floats[:, columns(known)], LEAST)
    return 0.5 * np.log(values / np.array([*known.values()]))


def truth_of(floats: Any) -> Any:
    """True errors, along and across in contact lengths and of the heading, and true v_x, v_y and
    yaw rate, (N, 6)."""
    values = floats[:, _MOTION]
    e_x, e_y, e_yaw = body_errors(values[:, :3].T, *values[:, 3:6].T)
    length = floats[:, columns(("contact_length",))[0]]
    return np.stack([e_x / length, e_y / length, e_yaw, *values[:, 6:].T], axis=1)


def drive(env: str, network: Any, job: Job) -> Episodes:
    """The episodes of a job. network: Layers, or None before the first regression."""
    scene, count = SCENES[env](job), job.count
    rng, seen, floats = scene.rng, scene.seen, scene.floats
    if network is not None:
        student = BatchNetwork(network, count)
        hidden = np.zeros((count, regression.HIDDEN), np.float32)
    taught = rng.random(count) < TEACHER_DRIVES[min(job.round, len(TEACHER_DRIVES) - 1)]
    steps = scene.simulation.settings.max_steps
    features = np.zeros((count, steps, len(FEATURES)), np.float16)
    targets = np.zeros((count, steps, 3 + len(scene.known)), np.float16)
    disturbance = Disturbance(rng, count, scene.disturbed)
    for n in range(steps):
        x = seen.see(scene.observation, scene.start)
        right = scene.teach()
        features[:, n] = x
        targets[:, n, :3] = scene.target(right)
        targets[:, n, 3:] = known_of(floats, scene.known)
        action = seen.begin.copy() if network is None else seen.action(student(x, hidden))
        action[taught] = right[taught] + disturbance.next()[taught]
        if scene.step(action):
            break
    lengths = np.array(scene.simulation.steps)
    scene.env.close()
    return Episodes(features, targets, lengths)


class AnyVehicle(Imitation):
    """The task."""

    columns = ("left", "slow", "told", "untold")
    job = 32

    def __init__(self, options: Any) -> None:
        scene = SCENES[options.env]
        super().__init__(options, len(FEATURES), 2, len(scene.known), scene.slow)
        self.drive = partial(drive, options.env)
        if options.env == SPEED_ID:
            self.job = JOB_BY_SPEED

    def layers(self, weights: Any) -> Layers:
        """Layers of the network in the loop."""
        return policy_layers(weights, self.options.recurrent)

    def left(self, y: Any, out: Any) -> Any:
        """Of the sum and the difference of both sides, in units of the weight."""
        return sum_and_difference((y[..., :2] - out) * (SHARP * y[..., 2:3]))

    @torch.no_grad()
    def report(self, of: Regression) -> list[float]:
        """RMS of what is left of the actions over that without a network on what is held out of the
        last round, as it is, its slow part, and by what is told."""
        sums = np.zeros((2, 4))
        told = FEATURES.index("is_told")
        for features, targets, lengths in of.batches(True, None, 128, last=True):
            valid = torch.arange(features.shape[0], device=of.device)[:, None] < lengths
            x, y = features.float(), targets.float()
            out = of.best(x)[0]
            weight = y[..., 2:3] * valid[..., None]
            for row, left in zip(
                sums, ((y[..., :2] - out) * weight, y[..., :2] * weight), strict=True
            ):
                is_told = x[..., told : told + 1]
                slow = self.low_pass(left)[-1]
                for k, part in enumerate((left, slow, left * is_told, left * (1.0 - is_told))):
                    row[k] += float((part * part).sum())
        ratio: list[float] = np.sqrt(sums[0] / np.maximum(sums[1], 1e-12)).tolist()
        return ratio

    def recipe(self) -> dict[str, Any]:
        """What an archive says of its kind."""
        o = self.options
        return {
            "augmentation": ANY_VEHICLE, "augmentation_options": {"recurrent": o.recurrent},
            "environment": {"id": o.env},
            "command": " ".join(["python -m agents.untold_training", *o.words]),
        }  # fmt: skip


def parse(words: list[str]) -> Any:
    """The options of the command line."""
    parser = regression.parser_of(
        (__doc__ or "").partition("\n")[0],
        episodes=384, further=320, rounds=12, epochs=1, batch=32, chunk=40, most=1024, rate=1.5e-3,
    )  # fmt: skip
    add, ids = parser.add_argument, as_argument(find_id)
    add("--env", type=ids, choices=[*SCENES], default=TORQUE_ID, help="id of the environment")
    add("--last-epochs", type=int, default=6, help="of the last regression")
    if parser.parse_args(words).env == SPEED_ID:
        parser.set_defaults(**BUDGET_BY_SPEED)
    options = parser.parse_args(words)
    options.words = words
    return options


if __name__ == "__main__":
    options = parse(sys.argv[1:])
    regression.train(options, AnyVehicle(options))
