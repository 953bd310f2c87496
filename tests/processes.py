"""Python in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent


def python(*arguments, status=0, cwd=REPOSITORY, path=(), **variables):
    """A process that has ended with this exit status, and what it printed.

    status: None for any. path: folders whose modules come before those of the clone. variables: of
    its environment.
    """
    folders = os.pathsep.join(str(folder) for folder in (*path, REPOSITORY))
    done = subprocess.run(
        [sys.executable, *(str(one) for one in arguments)], cwd=cwd, capture_output=True, text=True,
        timeout=300, env={**os.environ, "PYTHONPATH": folders, **variables},
    )  # fmt: skip
    assert status in (None, done.returncode), done.stderr
    return done
