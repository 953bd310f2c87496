"""Train an RL agent on randomized tracked vehicles and soils, in minutes on two cores.

All vehicles of a batch are stepped in one process. OUTPUT gets agent.zip (the best on held-out
episodes), last.zip, config.json and curve.csv. Killed? The same command with --resume goes on
from the last checkpoint. Compare the agent with the controllers afterwards:

    python evaluate.py --policies nominal adaptive oracle runs/ppo-blind-seed0/agent.zip

Several trainings, on the processors of this machine or of others:

    python train.py --seeds 0:5 --workers 2
"""

import io
import os
import platform
import sys
import threading
import time

from agents.folder import (
    INTERRUPTED,
    Refused,
    failed,
    interrupted,
    raise_again,
    refusing,
    stop_at_once,
)

if __name__ == "__main__":
    stop_at_once("train.py: interrupted before the training began")  # the imports take seconds

from collections.abc import Iterable, Sequence
from contextlib import ExitStack, redirect_stdout, suppress
from dataclasses import fields, make_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

try:
    import gymnasium
    import torch
    import tyro
    from tqdm import tqdm

    from agents import checkpoint as checkpoints
    from agents import sweep as several
    from agents.environments import make_held_out
    from agents.folder import AlreadyFinished, begin, finish, going_on
    from agents.options import (
        REGISTRY,
        Options,
        check_given,
        check_names,
        in_words,
        options_of_train,
    )
    from agents.progress import Diverged, Learner, Progress
    from agents.run import Run, chosen_settings, resolve
    from agents.sweep import compared
except ImportError as error:
    sys.exit(f"train.py: {error}. Run `make install`, or pip install 'tracked-env[rl,cli]'")

from baselines.learned.agent_archive import read_recipe
from tracked_env.benchmark.files import locked

LINGERS = 150.0  # [s] for which a training that was given up on may still hold its folder
FREE = ("resume", "overwrite", "output", "tensorboard", "quiet", "trust")  # may differ
WRONG = (ValueError, OSError, gymnasium.error.Error)  # what wrong settings raise


def progress_bar(total: int, done: int, quiet: bool) -> "tqdm[Any]":
    """The progress bar of a training of which so many steps are done."""
    return tqdm(
        total=total, initial=done, unit=" steps", unit_scale=True, disable=quiet,
        dynamic_ncols=True, mininterval=0.1 if sys.stderr.isatty() else 30.0,  # [s]
    )  # fmt: skip


def made(run: Run, captured: Any) -> tuple[Learner, Progress]:
    """What learns and its progress, untrained or as a checkpoint has it. Raises ValueError."""
    learner = run.algorithm.learner(run)
    progress = Progress(run, learner, make_held_out(run))
    if captured is not None:
        checkpoints.put_back(captured, learner, progress)
    return learner, progress


def train(options: Options) -> None:
    """Train and save. Raises Refused, AlreadyFinished, Diverged and OSError."""
    with refusing(*WRONG):
        run = resolve(options)
        config = run.recipe["config"]
        captured = going_on(run.folder, config, FREE, options.resume, options.overwrite)
        learner, progress = made(run, captured)
    begin(run.folder, progress.recipe, learner.steps)
    with progress_bar(run.schedule.total, learner.steps, options.quiet) as bar:
        progress.count = bar.update
        progress.on_text = lambda text: bar.set_postfix_str(text, refresh=False)
        learner.learn(progress)
    finish(run.folder, progress.recipe)
    best = f"best {progress.best:.4f} m held out, " if run.held_out else ""
    print(
        f"done: {learner.steps:,} steps in {progress.seconds:.0f} s, {best}"
        f"{progress.throughput:,.0f} steps/s with the learner; {run.folder / 'agent.zip'}"
    )


def diverged(error: Diverged, options: Options) -> str:
    """What to do about a training that diverged."""
    name, settings = chosen_settings(options)
    rate = getattr(settings, "learning_rate", None)
    hint = "" if rate is None else f"Lower --{name}.learning-rate (now {rate:g}) and train"
    return (
        f"{error}. {hint or 'Train'} anew with --overwrite; {options.folder} keeps the agent and "
        "the checkpoint of before"
    )


def main(options: Options) -> int:
    """Train and save, alone in the folder; returns the exit status."""
    folder = options.folder
    torch.set_num_threads(options.threads)
    with ExitStack() as held:
        try:
            with refusing(ValueError):
                held.enter_context(locked(folder, "a training"))
            train(options)
        except AlreadyFinished as notice:
            print(notice)
        except KeyboardInterrupt:
            return interrupted(folder, checkpoints.exist(folder))
        except Refused as error:
            return failed(error)
        except Diverged as error:
            return failed(diverged(error, options))
        except OSError as error:
            return failed(
                f"--output {folder} cannot be written ({error}). Make room or choose another "
                "folder; a checkpoint there is kept, and --resume goes on from it"
            )
    return 0


def train_one(place: several.Place, job: several.Job) -> several.Trained:
    """One training of several, in a process of its own: begun, or gone on with."""
    options = options_of_train()(**job.options)
    folder = options.folder
    sys.argv = list(place.command)  # the recipe says what the user asked for
    if not Path(place.folder, folder).is_dir():
        return several.Trained(
            f"{Path(place.folder, folder)} is not there on {platform.node()}; --output must be on "
            "a disk that all nodes share, and the working directory too", failed=True,
        )  # fmt: skip
    os.chdir(place.folder)
    torch.set_num_threads(options.threads)
    tqdm.set_lock(threading.RLock())  # the usual one is a semaphore, which a kill would leave
    with ExitStack() as held, redirect_stdout(io.StringIO()):
        try:
            with refusing(ValueError):
                hold(held, folder)
            train(options)
        except AlreadyFinished:
            pass
        except (Refused, OSError) as error:
            return several.Trained(" ".join(str(error).split()), failed=True)
        except Diverged as error:
            return several.Trained(diverged(error, options), failed=True)
    recipe = read_recipe(folder / "agent.zip") or {}
    best = recipe.get("held_out_rmse")
    score = "" if best is None else f", best {best:.4f} m held out"
    return several.Trained(f"done{score}; {folder / 'agent.zip'}", failed=False)


def hold(held: ExitStack, folder: Path) -> None:
    """Lock a folder, when a process that was given up on has let go of it. Raises ValueError."""
    until = time.monotonic() + LINGERS
    while True:
        try:
            held.enter_context(locked(folder, "a training"))
            return
        except ValueError:
            if time.monotonic() > until:
                raise
        time.sleep(0.5)


def check_all(trainings: Iterable[Options]) -> None:
    """Refuse what cannot be trained, before anything is written. Raises Refused."""
    known: set[str] = set()
    with refusing(*WRONG):
        for options in trainings:
            run = resolve(options)
            config, again = run.recipe["config"], (options.resume, options.overwrite)
            with suppress(AlreadyFinished):
                going_on(run.folder, config, FREE, *again)
            alike = repr(replace(options, seed=0, output=None))
            if alike not in known:  # of trainings that differ in their seed, one is made
                made(run, None)
            known.add(alike)


def prepared(options: Options) -> None:
    """Make the folder of a training, emptied if that is asked for."""
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.overwrite:
        run = resolve(options)
        with locked(run.folder, "a training"):
            begin(run.folder, run.recipe, 0)


def main_of_several(options: Any, kind: type[Options]) -> int:
    """Several trainings, then the table of a sweep; returns the exit status."""
    try:
        with refusing(ValueError):
            executor, shard = several.executor_of(options)
            trainings, plan = several.planned(options, kind)
            trainings = several.part_of(trainings, shard)
        check_all(trainings.values())
        with refusing(ValueError):
            for each in trainings.values():
                prepared(each)
        # By the name of this module, which other processes can import.
        failures = several.train_all(
            trainings, executor, import_module("train").train_one, options.quiet
        )
        if plan is not None and shard is None:
            with refusing(ValueError):
                print(f"\n{compared(plan, executor)}")
    except KeyboardInterrupt:
        again = "run it again" if options.sweep else "go on with --resume"
        print(f"interrupted; checkpoints are kept, {again}", file=sys.stderr)
        return INTERRUPTED
    except (Refused, OSError) as error:
        return failed(error)
    return failed(f"{failures} of {len(trainings)} trainings failed") if failures else 0


def command(arguments: Sequence[str] | None = None) -> int:
    """Train as the command line says; returns the exit status.

    It has the algorithms that are registered when it is called.
    """
    kind = options_of_train()
    named: list[Any] = [
        (each.name, in_words(each.type), each.default)
        for of in (kind, several.Several)
        for each in fields(of)
        if in_words(each.type) is not each.type
    ]
    both: Any = make_dataclass("Config", named, bases=(several.Several, kind), frozen=True)
    both.__doc__ = kind.__doc__
    given = sys.argv[1:] if arguments is None else arguments
    try:
        check_names(given)
        options: Any = tyro.cli(both, args=given, description=__doc__, registry=REGISTRY)
        check_given(given, options)
    except ValueError as error:
        return failed(error)
    raise_again()
    try:
        more = several.asked(options)
    except ValueError as error:
        return failed(error)
    return main_of_several(options, kind) if more else main(several.one(options, kind))


if __name__ == "__main__":
    sys.exit(command())
