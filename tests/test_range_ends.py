"""Thousands of steps with options at the ends of their ranges stay inside what is documented."""

import inspect

import numpy as np
import pytest

from tracked_env import SPEED
from tracked_env import arrays as b
from tracked_env.engine.episode import START_RANGES
from tracked_env.env import TrackedVehicleEnv
from tracked_env.events import _FIELDS, CHANGEABLE
from tracked_env.physics.parameters import GROUPS, RANGES, STATE_NAMES
from tracked_env.references import REFERENCES
from tracked_env.references.specification import QUANTITIES, START_POSE
from tracked_env.sensors import _RANGES as SENSOR_RANGES
from tracked_env.vector_env import TrackedVehicleVectorEnv

ROWS, STEPS = 64, 32
LIMITS = {"duration": 0.5, "error_limit": 5.0}  # 25 steps: episodes end both ways
KINDS = {
    "Torque-v0": {},
    "Torque-v0 constrained": {"lateral": "constrained"},
    "Torque-v0 on patches": {"plant": "distributed"},
    "Speed-v0": SPEED,
}


class Ends:
    """Draws options at the ends of their ranges, and knows which ends it has drawn."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.seen = set()

    def of(self, name, allowed):
        high = bool(self.rng.integers(2))
        self.seen.add((name, high))
        return float(allowed[1] if high else allowed[0])

    def some(self, ranges, share=0.5):
        chosen = [name for name in ranges if self.rng.random() < share]
        return {name: self.of(name, ranges[name]) for name in chosen}

    def event(self):
        kind = str(self.rng.choice(list(_FIELDS)))
        names = [n for n in CHANGEABLE if kind != "wave" or n.endswith("_resistance")]
        parameter = str(self.rng.choice(names))
        fields = {f"{kind}.{name}": allowed for name, _, allowed in _FIELDS[kind]}
        drawn = {name.split(".")[1]: end for name, end in self.some(fields, 1.0).items()}
        drawn |= {"start": 0.1} if kind == "ramp" and self.rng.random() < 0.5 else {}
        target = self.of(f"{kind}.target", RANGES[parameter])
        return {"parameter": parameter, "kind": kind, "target": target, **drawn}

    def reference(self):
        kind = str(self.rng.choice([k for k in REFERENCES if k not in ("waypoints", "mixed")]))
        arguments = inspect.signature(REFERENCES[kind]).parameters
        ranges = {n: QUANTITIES[n] for n in (*arguments, *START_POSE) if n in QUANTITIES}
        return {"kind": kind, **self.some(ranges, 0.3)}

    def sensors(self):
        drawn = self.some({n: r for n, r in SENSOR_RANGES.items() if n != "velocity_measured"})
        return drawn | ({"velocity_measured": 0} if self.rng.random() < 0.3 else {})

    def options(self):
        parts = {
            **{
                group: lambda names=names: self.some({name: RANGES[name] for name in names})
                for group, names in GROUPS.items()
            },
            "reference": self.reference,
            "sensors": self.sensors,
            "start": lambda: self.some(START_RANGES, 0.3),
            "schedule": lambda: [self.event() for _ in range(self.rng.integers(1, 4))],
        }
        return {name: draw() for name, draw in parts.items() if self.rng.random() < 0.6}


def accepted(ends, probe):
    """Options that the environment accepts; those that do not go together are refused in a line."""
    while True:
        options = ends.options()
        try:
            probe.reset(seed=0, options=options)
        except ValueError as error:
            assert "\n" not in str(error) and ";" in str(error)
        else:
            return options


def actions_of(rng, steps):
    """Random, extreme, constant, tiny and oversized actions (steps, ROWS, 2), a kind per row."""
    shape = (steps, ROWS, 2)
    kinds = np.stack(
        [
            rng.uniform(-1.0, 1.0, shape),
            rng.choice([-1.0, 1.0], shape),
            np.broadcast_to(rng.choice([-1.0, 0.0, 0.3, 1.0], (1, ROWS, 2)), shape),
            rng.choice([0.0, 1e-30, -1e-7], shape),
            rng.choice([-1e30, 2.0, 1e38], shape),
        ]
    )
    return kinds[np.arange(ROWS) % len(kinds), :, np.arange(ROWS)].transpose(1, 0, 2).astype("f4")


@pytest.mark.parametrize(
    ("kind", "rounds"),
    [
        *((kind, 3) for kind in KINDS),
        *(pytest.param(kind, 10, marks=pytest.mark.slow) for kind in KINDS if kind.endswith("-v0")),
    ],
)
def test_no_option_at_the_end_of_its_range_leads_out_of_what_is_documented(kind, rounds):
    arguments = {**KINDS[kind], **LIMITS}
    env = TrackedVehicleVectorEnv(ROWS, **arguments, expose_truth=True)
    singles = [TrackedVehicleEnv(**arguments, expose_truth=True) for _ in range(ROWS)]
    ends, rng = Ends(list(KINDS).index(kind)), np.random.default_rng(1)
    space = env.observation_space
    endings = {"terminated": 0, "truncated": 0}
    for episode in range(rounds):
        rows = [accepted(ends, singles[0]) for _ in range(ROWS)]
        observations, _ = env.reset(seed=1000 * episode, options={"rows": rows})
        assert space.contains(observations)
        for i, single in enumerate(singles):
            first, _ = single.reset(seed=1000 * episode + i, options=rows[i])
            assert np.array_equal(first, observations[i])
        over = np.zeros(ROWS, dtype=bool)
        for actions in actions_of(rng, STEPS):
            observations, rewards, terminated, truncated, info = env.step(actions)
            assert space.contains(observations)
            assert np.all((rewards >= -0.1) & (rewards <= 1.0))
            assert not (terminated & truncated).any() and not (terminated | truncated)[over].any()
            distance = info["tracking_error"][:, 0]
            motion = np.array([info["truth"][name] for name in STATE_NAMES])
            diverged = ~np.isfinite(motion).all(axis=0)
            assert not diverged.any() or "constrained" in kind  # unstable: see icr_forward
            away = diverged | (distance > LIMITS["error_limit"])
            assert np.array_equal(terminated[~over], away[~over])
            assert np.all(rewards[diverged] == -0.1)
            steps = env.simulation.batch.counters[:, b.STEP]
            assert np.array_equal(truncated, (steps == 25) & ~terminated)
            assert np.all(steps[over] == 0) and np.all(rewards[over] == 0.0)  # started anew
            for i, single in enumerate(singles):
                if over[i]:
                    assert np.array_equal(single.reset()[0], observations[i])
                    continue
                readings, reward, *flags, _ = single.step(actions[i])
                assert np.array_equal(readings, observations[i]), rows[i]
                assert reward == rewards[i] and flags == [terminated[i], truncated[i]]
            over = terminated | truncated
            endings["terminated"] += int(terminated.sum())
            endings["truncated"] += int(truncated.sum())
    assert min(endings.values()) > 50
    both = {(name, end) for name in (*RANGES, *START_RANGES) for end in (False, True)}
    assert both <= ends.seen
    env.close()
