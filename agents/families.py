"""All agents of the benchmark on equal terms: five seeds of each family, one after the other.

    python -m agents.families                                  # everything; hours
    python -m agents.families --families ppo-blind ppo-student --seeds 0:1
    nice python -m agents.families --threads 2 > families.log &

Every family of an environment has the same laws and sensors (`mixture`), the data sheet of its
sensors where it acts on sensors, and the action-rate penalty of 1. PPO has 2 M steps on Torque-v0,
recurrent PPO too, residual agents 0.4 M, since more gained nothing; agents with a replay buffer
have what they can afford in the time, a seventh of that or less. A student comes after its teacher
of the same seed. A finished training is not repeated, an interrupted one goes on: give the same
command again.
"""

import argparse
import csv
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from agents.sweep_file import parse_seeds

ROOT = Path(__file__).resolve().parent.parent
TERMS = "--uncertainty mixture --sensors mixture"
SHOWN = f"{TERMS} --data-sheet"
PPO = "--steps 2000000"
RESIDUAL = "--steps 400000 --augmentation residual --ppo.log-std-init -2"  # more did not help
REPLAY = "--smoothness 1"  # which agents with a replay buffer would leave out
STUDENT = (
    "--augmentation student --student.lstm-hidden 64 --student.hidden 64 --student.n-steps 250 "
    "--student.batch-size 16000 --student.buffer-size 400000 --student.gradient-steps 24 "
    "--vehicles 60 --steps 1600000"
)
# By family: whose agent of the same seed teaches it.
TEACHERS = {"ppo-student": "ppo-teacher", "ppo-student-estimates": "ppo-teacher"}

# By environment, name of the family -> its options of train.py.
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
        "sac-blind": f"{SHOWN} --agent sac --steps 300000 {REPLAY}",
        "td3-blind": f"{SHOWN} --agent td3 --steps 300000 {REPLAY}",
        "tqc-blind": f"{SHOWN} --agent tqc --steps 150000 {REPLAY}",
    },
    "Speed-v0": {
        "ppo-blind": f"{SHOWN} --steps 1500000",
        "ppo-reckoned": f"{SHOWN} --steps 1500000 --augmentation reckoned",
        "ppo-residual": f"{SHOWN} {RESIDUAL} --residual-scale 0.1",
    },
    "Terrain-v0": {
        "ppo-blind": f"{SHOWN} --steps 1500000",
        "ppo-reckoned": f"{SHOWN} --steps 1500000 --augmentation reckoned",
        "ppo-residual": f"{SHOWN} --steps 300000 --evaluate-every 100000 --augmentation residual "
        "--ppo.log-std-init -2 --residual-scale 0.1",
    },
}


def command(env: str, family: str, seed: int, output: Path) -> list[str]:
    """Arguments of train.py for one training, which goes on where it was."""
    more = []
    if family in TEACHERS:
        more = ["--teacher", str(output / env / f"{TEACHERS[family]}-seed{seed}" / "agent.zip")]
    folder = str(output / env / f"{family}-seed{seed}")
    return [
        "--env", f"tracked_env/{env}", *shlex.split(FAMILIES[env][family]), *more,
        "--seed", str(seed), "--output", folder, "--resume", "--quiet",
    ]  # fmt: skip


def cpu_minutes(folder: Path) -> tuple[float, float]:
    """Processor time of a finished training [min], and its best error on held-out episodes [m]."""
    with (folder / "curve.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    errors = [float(row["held_out_rmse"]) for row in rows if row["held_out_rmse"] != "nan"]
    return float(rows[-1]["cpu_seconds"]) / 60.0, min(errors, default=float("nan"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Train all that is asked for; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--families", nargs="+", help="names, of every environment; default: all")
    parser.add_argument("--envs", nargs="+", default=[*FAMILIES], choices=[*FAMILIES])
    parser.add_argument("--seeds", default="0:5", help="FIRST:END without the end, or 1,3")
    parser.add_argument("--output", type=Path, default=Path("runs", "families"))
    parser.add_argument("--threads", type=int, default=1, help="of PyTorch")
    given = parser.parse_args(arguments)
    known = {name for families in FAMILIES.values() for name in families}
    wrong = sorted(set(given.families or ()) - known)
    if wrong:
        parser.error(f"unknown family {wrong[0]!r}; known are {', '.join(sorted(known))}")
    try:
        seeds = parse_seeds(given.seeds)
    except ValueError as error:
        parser.error(str(error))
    failures = 0
    for seed in seeds:
        for env in given.envs:
            for family in FAMILIES[env]:
                if given.families and family not in given.families:
                    continue
                words = command(env, family, seed, given.output)
                words += ["--threads", str(given.threads)]
                ended = subprocess.run([sys.executable, "train.py", *words], cwd=ROOT, check=False)
                if ended.returncode:
                    failures += 1
                    print(f"{env} {family} seed {seed}: failed", flush=True)
                    continue
                minutes, best = cpu_minutes(ROOT / given.output / env / f"{family}-seed{seed}")
                print(
                    f"{env} {family} seed {seed}: {minutes:.1f} min of processor time, best "
                    f"{best:.4f} m held out",
                    flush=True,
                )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
