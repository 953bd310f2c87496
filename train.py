"""Train a PPO agent on randomized tracked vehicles and soils, in minutes on two cores.

All vehicles of a batch are stepped in one process. The agent, its exact configuration, the
versions and the learning curve go to OUTPUT. Compare it with the controllers afterwards:

    python evaluate.py --policies nominal oracle runs/ppo/agent.zip
"""

import json
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

try:
    import torch
    import tyro

    from agents.ppo import PPOConfig, Progress, describe, make_model
    from tracked_env.sb3 import make_vec_env
except ImportError as error:
    sys.exit(f"train.py: {error}. Run `make install`, or pip install 'tracked-env[rl,cli]'")

from tracked_env import TORQUE_ID
from tracked_env.benchmark.store import machine, versions, write_atomically


@dataclass(frozen=True)
class Config:
    """What to train, on what, and where it goes."""

    steps: int = 2_000_000
    """Environment steps, over all vehicles."""

    seed: int = 0
    """Of the networks and of the vehicles: same seed, same machine, same agent."""

    uncertainty: str = "soil-and-mass"
    """Uncertainty set to train on."""

    sensors: str = "rtk"
    """Sensor preset: ideal, rtk or strawa."""

    reference: str = "random"
    """Kind of reference to follow."""

    output: Path = Path("runs/ppo")
    """Folder for agent.zip, config.json and curve.csv."""

    tensorboard: bool = False
    """Also write TensorBoard logs to OUTPUT."""

    threads: int = 1
    """Threads of PyTorch; one is often faster than two for networks of this size."""

    ppo: PPOConfig = field(default_factory=PPOConfig)
    """Settings of PPO."""


def main(config: Config) -> int:
    """Train and save; returns the exit status."""
    torch.set_num_threads(config.threads)
    env_kwargs = {
        "uncertainty": config.uncertainty,
        "sensors": config.sensors,
        "reference": config.reference,
    }
    try:
        env = make_vec_env(TORQUE_ID, config.ppo.n_envs, config.seed, env_kwargs)
    except ValueError as error:
        print(f"train.py: {error}", file=sys.stderr)
        return 2
    config.output.mkdir(parents=True, exist_ok=True)
    log = str(config.output) if config.tensorboard else None
    model = make_model(env, config.ppo, config.seed, log)
    curve: list[str] = ["steps,seconds,mean_return"]
    began = time.perf_counter()

    def report(steps: int, mean_return: float) -> None:
        seconds = time.perf_counter() - began
        curve.append(f"{steps},{seconds:.2f},{mean_return:.3f}")
        done = 100.0 * steps / config.steps
        print(
            f"\r{done:5.1f} %  {steps:>10,} steps  {steps / seconds:>8,.0f} steps/s  "
            f"mean return {mean_return:7.1f} of at most 1500",
            end="",
            flush=True,
        )

    interrupted = False
    try:
        model.learn(config.steps, callback=Progress(report))
    except KeyboardInterrupt:
        interrupted = True
    seconds = time.perf_counter() - began
    extra = {
        "command": " ".join(["python", *sys.argv]),
        "environment": {"id": TORQUE_ID, **env_kwargs},
        "config": json.loads(json.dumps(asdict(config), default=str)),
        "steps": model.num_timesteps,
        "seconds": round(seconds, 1),
        "interrupted": interrupted,
        "versions": versions(),
        "machine": machine(),
    }
    model.save(config.output / "agent.zip")
    text = json.dumps(describe(config.ppo, extra), indent=2)
    write_atomically(config.output / "config.json", text.encode())
    write_atomically(config.output / "curve.csv", "\n".join(curve).encode())
    state = "interrupted" if interrupted else "done"
    print(f"\n{state} after {model.num_timesteps:,} steps and {seconds:.0f} s; {config.output}")
    return 130 if interrupted else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Config, description=__doc__)))
