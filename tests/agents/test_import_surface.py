"""What one training loads: few of the project's files besides those of its environment."""

import subprocess
import sys

# Modules of the project, packages too, that lie in files: those that a tiny training of a blind
# agent adds to the ones that making and resetting its environment has loaded.
COUNT = """
import sys
import gymnasium, tracked_env
def modules():
    folders = ("tracked_env", "baselines", "agents", "train")
    return {name for name in sys.modules if name.partition(".")[0] in folders}
gymnasium.make(tracked_env.TORQUE_ID).reset(seed=0)
before = modules()
import train
assert train.command(sys.argv[1].split()) == 0
print(*sorted(modules() - before))
"""
TINY = (
    "--steps 64 --vehicles 4 --held-out 2 --duration 0.4 --quiet --uncertainty payload "
    "--ppo.n-steps 16 --ppo.batch-size 32 --output "
)


def test_a_training_loads_at_most_35_files_besides_those_of_its_environment(repository, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", COUNT, f"{TINY}{tmp_path / 'out'}"],
        cwd=repository, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    names = done.stdout.splitlines()[-1].split()
    assert 20 < len(names) <= 35, names
    assert not any(
        name.startswith(("baselines.linearizing", "baselines.lyapunov")) for name in names
    )
