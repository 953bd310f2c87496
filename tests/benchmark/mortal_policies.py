"""Policies that end the process in which they run, as the memory killer of a system does.

Imported as a module of its own, from this folder, in the processes that run it.
"""

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

MARK = "TRACKED_ENV_TEST_MARK"  # names a file: that the first process has ended


class Constant:
    """The same action always; its state counts the steps."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        return np.full((len(observation), 2), np.float32(0.3)), (state or 0) + 1


class Spin(Constant):
    """Turns on the spot, so that the reference leaves it behind."""

    def predict(self, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
        action, state = super().predict(*args, **kwargs)
        return action * np.float32([-3.0, 3.0]), state


def end_once() -> None:
    """End this process by a signal, the first time that any process gets here."""
    mark = Path(os.environ[MARK])
    try:
        mark.touch(exist_ok=False)
    except FileExistsError:
        return
    os.kill(os.getpid(), signal.SIGKILL)


class Mortal(Constant):
    """Ends its process in the third step of the first chunk, the first time."""

    def predict(self, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
        answer = super().predict(*args, **kwargs)
        if answer[1] == 3:
            end_once()
        return answer


class Deadly(Constant):
    """Ends its process always."""

    def predict(self, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
        os.kill(os.getpid(), signal.SIGKILL)
        return super().predict(*args, **kwargs)


class Wrong(Constant):
    """Raises an error in its third step."""

    def predict(self, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
        answer = super().predict(*args, **kwargs)
        if answer[1] == 3:
            raise KeyError("lacking")
        return answer


class Pausing(Constant):
    """On the node that a file `doomed` names: says that it is there, and waits for the end.

    On another node it waits until that has been said.
    """

    def predict(self, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
        answer = super().predict(*args, **kwargs)
        folder = Path(os.environ[MARK])
        if answer[1] == 3 and (folder / "doomed").exists():
            import ray

            node = ray.get_runtime_context().get_node_id()
            if node == (folder / "doomed").read_text():
                (folder / "reached").touch()
                time.sleep(60.0)
            until = time.monotonic() + 60.0
            while not (folder / "reached").exists() and time.monotonic() < until:
                time.sleep(0.02)
        return answer


def trained_and_noted(place: Any, job: Any) -> Any:
    """One training of several; a file says on which node of a Ray cluster it runs."""
    import ray

    import train

    node = ray.get_runtime_context().get_node_id()
    Path(place.folder, f"{job.name}.node").write_text(node)
    return train.train_one(place, job)


def sleep(shared: Any, job: float) -> None:
    """A long job; the file says that it has begun."""
    Path(os.environ[MARK]).touch()
    time.sleep(job)
