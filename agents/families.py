"""All agents of the benchmark on equal terms: five seeds of each family, one after the other.

    python -m agents.sweep                                  # everything; hours
    python -m agents.sweep --families ppo-blind ppo-student --seeds 0:1
    nice python -m agents.sweep --threads 2 > families.log &

Every family of an environment has the same laws and sensors (`mixture`), the data sheet of its
sensors where it acts on sensors, and the action-rate penalty of 1. PPO has 2 M steps on Torque-v0,
recurrent PPO too, residual agents 0.4 M, since more gained nothing; agents with a replay buffer
have what they can afford in the time, a seventh of that or less. A student comes after its teacher
of the same seed. A finished training is not repeated, an interrupted one goes on: give the same
command again.
"""

import argparse
import shlex
import subprocess
import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from agents.sweep import parse_seeds
from tracked_env.cli.command_line import as_argument

ROOT = Path(__file__).resolve().parent.parent
TERMS = "--uncertainty mixture --sensors mixture"
SHOWN = f"{TERMS} --data-sheet"
PPO = "--steps 2000000"
BLIND, RECKONED = f"{SHOWN} --steps 1500000", f"{SHOWN} --steps 1500000 --augmentation reckoned"
RESIDUAL = "--steps 400000 --augmentation residual --ppo.log-std-init -2"  # more did not help
STUDENT = (
    "--augmentation student --student.lstm-hidden 64 --student.hidden 64 --student.n-steps 250 "
    "--student.batch-size 16000 --student.buffer-size 400000 --student.gradient-steps 24 "
    "--vehicles 60 --steps 1600000"
)
# By family: whose agent of the same seed teaches it.
TEACHERS = {"ppo-student": "ppo-teacher", "ppo-student-estimates": "ppo-teacher"}

# By environment, name of the family -> its options of train.py. Agents with a replay buffer would
# leave out the action-rate penalty.
FAMILIES = {
    "Torque-v0": {
        "ppo-blind": f"{SHOWN} {PPO}",
        "ppo-history": f"{SHOWN} {PPO} --augmentation history",
        "ppo-reckoned": f"{SHOWN} {PPO} --augmentation reckoned",
        "ppo-estimates": f"{SHOWN} {PPO} --augmentation estimates",
        "ppo-residual": f"{SHOWN} {RESIDUAL} --residual-scale 0.05",
        "ppo-residual-mpc": f"{SHOWN} {RESIDUAL} --residual-scale 0.05 --base mpc-adaptive",
        "ppo-teacher": f"--uncertainty mixture --sensors ideal {PPO} --augmentation teacher",
        "ppo-student": f"{SHOWN} {STUDENT}",
        "ppo-student-estimates": f"{SHOWN} {STUDENT} --student.features estimates",
        "recurrent-ppo-blind": f"{SHOWN} {PPO} --agent recurrent-ppo --recurrent-ppo.n-steps 512",
        "sac-blind": f"{SHOWN} --agent sac --steps 300000 --smoothness 1",
        "td3-blind": f"{SHOWN} --agent td3 --steps 300000 --smoothness 1",
        "tqc-blind": f"{SHOWN} --agent tqc --steps 150000 --smoothness 1",
    },
    "Speed-v0": {
        "ppo-blind": BLIND,
        "ppo-reckoned": RECKONED,
        "ppo-residual": f"{SHOWN} {RESIDUAL} --residual-scale 0.1",
    },
    "Terrain-v0": {
        "ppo-blind": BLIND,
        "ppo-reckoned": RECKONED,
        "ppo-residual": f"{SHOWN} --steps 300000 --evaluate-every 100000 --augmentation residual "
        "--ppo.log-std-init -2 --residual-scale 0.1",
    },
}


def command(env: str, family: str, seed: int, output: Path) -> list[str]:
    """Arguments of train.py for one training, which goes on where it was."""
    words = ["--env", f"tracked_env/{env}", *shlex.split(FAMILIES[env][family])]
    if family in TEACHERS:
        teacher = output / env / f"{TEACHERS[family]}-seed{seed}" / "agent.zip"
        words += ["--teacher", str(teacher)]
    folder = str(output / env / f"{family}-seed{seed}")
    return [*words, "--seed", str(seed), "--output", folder, "--resume", "--quiet"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Train all that is asked for; returns the exit status."""
    names = sorted({name for families in FAMILIES.values() for name in families})
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--families", nargs="+", choices=names, help="of every environment")
    parser.add_argument("--envs", nargs="+", default=[*FAMILIES], choices=[*FAMILIES])
    seeds = as_argument(parse_seeds)
    parser.add_argument("--seeds", type=seeds, default="0:5", help="FIRST:END, or 1,3")
    parser.add_argument("--output", type=Path, default=Path("runs", "families"))
    parser.add_argument("--threads", default="1", help="of PyTorch")
    options = parser.parse_args(arguments)
    failures = 0
    for seed, env in product(options.seeds, options.envs):
        for family in (name for name in FAMILIES[env] if name in (options.families or names)):
            words = [*command(env, family, seed, options.output), "--threads", options.threads]
            ended = subprocess.run([sys.executable, "train.py", *words], cwd=ROOT, check=False)
            failures += ended.returncode != 0
            end = "failed" if ended.returncode else "done"
            print(f"{env} {family} seed {seed}: {end}", flush=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
