"""Train an RL agent on randomized tracked vehicles and soils, in minutes on two cores.

All vehicles of a batch are stepped in one process. OUTPUT gets agent.zip (the best on held-out
episodes), last.zip, config.json and curve.csv. Killed? The same command with --resume goes on
from the last checkpoint. Compare the agent with the controllers afterwards:

    python evaluate.py --policies nominal adaptive oracle runs/ppo-blind-seed0/agent.zip

Several trainings, on the processors of this machine or of others:

    python train.py --seeds 0:5 --workers 2
"""

import os
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress

if __name__ == "__main__" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # The imports take seconds, and an exception in the middle of one would be lost or replaced.
    LINE = b"train.py: interrupted before the training began\n"
    signal.signal(signal.SIGINT, lambda *_: (os.write(2, LINE), os._exit(130)))

import io
import platform
import threading
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

try:
    import gymnasium
    import torch
    from tqdm import tqdm

    from agents import checkpoint
    from agents import folder as run_folder
    from agents.folder import AlreadyFinished, Diverged
    from agents.learners import make_learner
    from agents.options import Options, Several, options_of_train, parse
    from agents.run import Run, resolve
except ImportError as error:
    sys.exit(f"train.py: {error}. Run `make install`, or pip install 'tracked-env[rl]'")

from baselines.learned.trained_agent import read_recipe
from tracked_env.benchmark.executors import make_executor
from tracked_env.benchmark.files import locked

INTERRUPTED, REFUSED = 130, 2  # exit status
RELEASE_TIME = 150.0  # [s] for which a training that was given up on may still hold its folder


class Refused(Exception):
    """What is asked for cannot be trained; nothing has been written."""


@contextmanager
def refusing() -> Iterator[None]:
    """Turn the errors of wrong settings into Refused."""
    try:
        yield
    except (ValueError, OSError, gymnasium.error.Error) as error:
        raise Refused(error) from error
    except MemoryError as error:
        raise Refused(f"{error}. Lower vehicles, n_steps or the sizes of buffers") from error


def failed(text: object) -> int:
    """Say in one line what is wrong; returns the exit status."""
    print("train.py:", " ".join(str(text).split()), file=sys.stderr)
    return REFUSED


def make_training(run: Run, state: Any) -> tuple[run_folder.Learner, run_folder.Progress]:
    """What learns and its progress, untrained or as a checkpoint has it. Raises ValueError."""
    learner = make_learner(run)
    progress = run_folder.Progress(run, learner, run_folder.make_held_out(run))
    if state is not None:
        checkpoint.put_back(state, learner, progress)
    return learner, progress


def train(options: Options) -> None:
    """Train and save. Raises Refused, AlreadyFinished, Diverged and OSError."""
    with refusing():
        run = resolve(options)
        learner, progress = make_training(run, run_folder.going_on(run))
    folder, total = options.folder, run.options.steps
    run_folder.begin(folder, progress.recipe, learner.steps)
    with tqdm(
        total=total, initial=learner.steps, unit=" steps", unit_scale=True, disable=options.quiet,
        dynamic_ncols=True, mininterval=0.1 if sys.stderr.isatty() else 30.0,  # [s]
    ) as bar:  # fmt: skip
        progress.count = bar.update
        progress.on_text = lambda text: bar.set_postfix_str(text, refresh=False)
        learner.learn(progress)
    run_folder.finish(folder, progress.recipe)
    best = f"best {progress.best:.4f} m held out, " if run.held_out else ""
    print(
        f"done: {learner.steps:,} steps in {progress.seconds:.0f} s, {best}"
        f"{learner.steps / max(progress.seconds - progress.evaluating, 1e-9):,.0f} steps/s with "
        f"the learner; {folder / 'agent.zip'}"
    )


def advice(error: Diverged, options: Options) -> str:
    """What to do about a training that diverged."""
    rate = getattr(options.settings, "learning_rate", None)
    lower = (
        f"Lower --{options.algorithm}.learning-rate (now {rate:g}) and train" if rate else "Train"
    )
    return (
        f"{error}. {lower} anew with --overwrite; {options.folder} keeps the agent and the "
        "checkpoint of before"
    )


def attempt(options: Options, patience: float = 0.0) -> str:
    """Train and save, alone in the folder; returns what went wrong, in one line, or nothing.

    patience [s]: for which the folder may still be locked.
    """
    folder = options.folder
    torch.set_num_threads(options.threads)
    with ExitStack() as stack:
        try:
            wait_for_lock(stack, folder, patience)
            train(options)
        except AlreadyFinished as notice:
            print(notice)
        except Refused as error:
            return " ".join(str(error).split())
        except Diverged as error:
            return advice(error, options)
        except OSError as error:
            return (
                f"--output {folder} cannot be written ({error}). Make room or choose another "
                "folder; a checkpoint there is kept, and --resume goes on from it"
            )
    return ""


def wait_for_lock(stack: ExitStack, folder: Path, patience: float) -> None:
    """Lock a folder, when a process that was given up on has let go of it. Raises Refused."""
    until = time.monotonic() + patience
    while True:
        try:
            stack.enter_context(locked(folder, "a training"))
            return
        except ValueError as error:
            if time.monotonic() >= until:
                raise Refused(error) from error
        time.sleep(0.5)


def main(options: Options) -> int:
    """Train and save; returns the exit status."""
    folder = options.folder
    try:
        wrong = attempt(options)
    except KeyboardInterrupt:
        way = "no checkpoint yet, begin anew with --overwrite"
        way = "go on with --resume" if checkpoint.present(folder) else way
        print(f"interrupted; {way} --output {folder}", file=sys.stderr)
        return INTERRUPTED
    return failed(wrong) if wrong else 0


# Several trainings


def train_one(place: Any, job: Any) -> Any:
    """One training of several, in a process of its own: begun, or gone on with.

    place, job and what is returned: Place, Job and Ended of `agents.sweep`.
    """
    from agents import sweep

    options = options_of_train()(**job.options)
    folder = options.folder
    sys.argv = list(place.command)  # the recipe says what the user asked for
    if not Path(place.folder, folder).is_dir():
        return sweep.Ended(
            f"{Path(place.folder, folder)} is not there on {platform.node()}; --output must be on "
            "a disk that all nodes share, and the working directory too",
            failed=True,
        )
    os.chdir(place.folder)
    tqdm.set_lock(threading.RLock())  # the usual one is a semaphore, which a kill would leave
    with redirect_stdout(io.StringIO()):
        wrong = attempt(options, RELEASE_TIME)
    best = None if wrong else (read_recipe(folder / "agent.zip") or {}).get("held_out_rmse")
    score = "" if best is None else f", best {best:.4f} m held out"
    return sweep.Ended(wrong or f"done{score}; {folder / 'agent.zip'}", failed=bool(wrong))


def check_all(trainings: Iterable[Options]) -> None:
    """Refuse what cannot be trained, before anything is written. Raises Refused."""
    variants: set[str] = set()
    with refusing():
        for options in trainings:
            run = resolve(options)
            with suppress(AlreadyFinished):
                run_folder.going_on(run)
            alike = repr(replace(options, seed=0, output=None))
            if alike not in variants:  # of trainings that differ in their seed, one is made
                make_training(run, None)
            variants.add(alike)


def prepare(options: Options) -> None:
    """Make the folder of a training, emptied if that is asked for."""
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.overwrite:
        with locked(options.folder, "a training"):
            run_folder.begin(options.folder, resolve(options).recipe, 0)


def main_of_several(options: Options, several: Several) -> int:
    """Several trainings, then the evaluation of a sweep; returns the exit status."""
    from agents import sweep

    try:
        with refusing():
            shard = several.shard
            executor: Any = make_executor(several.workers, several.ray, shard) or make_executor(1)
            trainings, plan = sweep.planned(options, several)
            if shard is not None:
                trainings = dict(shard.of(list(trainings.items())))
            check_all(trainings.values())
            for each in trainings.values():
                prepare(each)
        # By the name of this module, which other processes can import.
        task = import_module("train").train_one
        status = 0
        failures = sweep.train_all(trainings, executor, task, options.quiet)
        if plan is not None and shard is None:
            status = sweep.compare_agents(plan, several, options.quiet)
    except KeyboardInterrupt:
        again = "run it again" if several.sweep else "go on with --resume"
        print(f"interrupted; checkpoints are kept, {again}", file=sys.stderr)
        return INTERRUPTED
    except (Refused, OSError) as error:
        return failed(error)
    return failed(f"{failures} of {len(trainings)} trainings failed") if failures else status


def command(arguments: Sequence[str] | None = None) -> int:
    """Train as the command line says; returns the exit status.

    It has the algorithms that are registered when it is called.
    """
    words = sys.argv[1:] if arguments is None else arguments
    try:
        options, several = parse(words, options_of_train(), __doc__ or "")
    except ValueError as error:
        return failed(error)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return main(options) if several == Several() else main_of_several(options, several)


if __name__ == "__main__":
    sys.path.insert(0, "")  # so that `module:namespace/Name-v0` finds modules of the current folder
    sys.exit(command())
