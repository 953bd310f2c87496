"""Compare policies on randomized tracked vehicles and soils: `tracked-env evaluate` from a clone.

Besides what that command does, it opens archives of Stable-Baselines3 (`--trust`, with the package
`agents`) and runs the experiments of papers again (`--paper`, with the package `reproduce`).
"""

import os
import signal
import sys

if __name__ == "__main__" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # Finished chunks are on disk, and what else a kill leaves is removed by the next run.
    LINE = b"\nevaluate.py: interrupted; finished episodes are kept, run it again\n"
    signal.signal(signal.SIGINT, lambda *_: (os.write(2, LINE), os._exit(130)))

from pathlib import Path

from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.cli.evaluate_command import run_config
from tracked_env.cli.evaluate_options import Config, parsed

__all__ = ["Config", "main"]


def reproduce(config: Config) -> int:
    """A paper's experiments; returns the exit status."""
    from reproduce import main as run_paper

    return run_paper(config.paper, config.output, config.figures)


def open_trusted(path: Path) -> PolicyEntry:
    """A trained agent, unpickled if need be; PyTorch is imported only here. Raises ValueError."""
    try:
        import torch

        from agents.archive import agent_entry
    except ImportError as error:
        raise ValueError(
            f"policy {str(path)!r}: {error}. Archives that hold pickled objects need "
            "pip install 'tracked-env[rl]'"
        ) from error
    torch.set_num_threads(1)  # networks this small are faster on one, and a busy machine is too
    return agent_entry(path, trust=True)


def main(config: Config) -> int:
    """Run what is asked for; returns the exit status. One line on stderr says what failed."""
    return run_config(config, "evaluate.py", open_trusted, reproduce)


if __name__ == "__main__":
    sys.path.insert(0, "")  # so that `module:attribute` finds modules of the current folder
    sys.exit(main(parsed(None, "evaluate.py")))
