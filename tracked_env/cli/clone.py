"""What only a clone of the repository has: training, the papers' experiments, pickled archives."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parents[2]  # the clone, where this package lies in one


def script(name: str) -> Path | None:
    """A script of the clone, None where this package is installed without one."""
    path = ROOT / name
    return path if path.is_file() and (ROOT / "pyproject.toml").is_file() else None


def run_script(name: str, arguments: Sequence[str]) -> NoReturn:
    """Go on as `python NAME ARGUMENTS` of the clone."""
    command = [sys.executable, str(ROOT / name), *arguments]
    sys.stdout.flush()
    if sys.platform == "win32":  # where exec returns to the shell at once
        sys.exit(subprocess.run(command, check=False).returncode)
    os.execv(sys.executable, command)


def main(arguments: Sequence[str], program: str) -> int:
    """`tracked-env train`: train.py of the clone. Returns the exit status."""
    if script("train.py") is None:
        print(
            f"{program}: training is not part of the installed package. Clone the repository and "
            "run `make install` there, then `python train.py`",
            file=sys.stderr,
        )
        return 2
    run_script("train.py", arguments)
