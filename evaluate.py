"""Compare policies on randomized tracked vehicles and soils: `tracked-env evaluate` from a clone.

Besides what that command does, it opens archives of Stable-Baselines3 (`--trust`, with the package
`agents`) and runs the experiments of papers again (`--paper`, with the package `reproduce`).
"""

import os
import signal
import sys
from contextlib import suppress

if __name__ == "__main__":
    # As `tracked_env.cli.interruption`, but before the imports, which take a second.
    def _stop(signum: int, frame: object) -> None:
        with suppress(Exception):
            sys.stdout.flush()
        os.write(2, b"\nevaluate.py: interrupted; finished episodes are kept, run it again\n")
        os._exit(130)  # as shells have it for Ctrl-C

    signal.signal(signal.SIGINT, _stop)

import time
from importlib import import_module
from pathlib import Path

from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.registered_policies import open_archive
from tracked_env.cli.evaluate_command import Extras, run_config
from tracked_env.cli.evaluate_options import Config, parsed

__all__ = ["Config", "main", "open_archive"]


def reproduce(config: Config) -> int:
    """A paper's experiments: run them, print what it claims beside what comes out, write the page.

    Without matplotlib the page has no figures.
    """
    began = time.perf_counter()
    folder = config.output / config.paper
    folder.mkdir(parents=True, exist_ok=True)
    paper = import_module(f"reproduce.{config.paper}")
    page, claims = (import_module(f"{paper.__name__}.{part}") for part in ("page", "claims"))
    baseline = import_module(f"reproduce.{config.paper}.baseline_tools")

    def say(text: str) -> None:
        print(f"{time.perf_counter() - began:5.0f} s  {text}", flush=True)

    results = paper.run_everything(paper.Tools(**baseline.TOOLS), say)
    say("page")
    try:
        files = page.write(results, folder, config.figures)
    except ImportError as error:
        print(f"not drawn: {error}", file=sys.stderr)
        files = page.write(results, folder, draw=False)
    print(f"\n{page.terminal(claims.claims(results))}\n")
    names = ", ".join(file.name for file in files if file.suffix != ".png")
    drawn = sum(file.suffix == ".png" for file in files)
    print(f"{names} and {drawn} figures in {folder}; {time.perf_counter() - began:.0f} s")
    return 0


def open_trusted(path: Path) -> PolicyEntry:
    """A trained agent, unpickled if need be; PyTorch is imported only here. Raises ValueError."""
    try:
        import torch

        from agents.loading import agent_entry
    except ImportError as error:
        raise ValueError(
            f"policy {str(path)!r}: {error}. Archives that hold pickled objects need "
            "pip install 'tracked-env[rl]'"
        ) from error
    torch.set_num_threads(1)  # networks this small are faster on one, and a busy machine is too
    return agent_entry(path, trust=True)


def main(config: Config) -> int:
    """Run what is asked for; returns the exit status. One line on stderr says what failed."""
    return run_config(config, "evaluate.py", Extras(open_trusted, reproduce))


if __name__ == "__main__":
    sys.path.insert(0, "")  # so that `module:attribute` finds modules of the current folder
    sys.exit(main(parsed(None, "evaluate.py")))
