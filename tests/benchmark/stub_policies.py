"""Policies for the tests of the benchmark: simple, wrong on purpose, or ending their process.

Other processes import it from this folder, as `stub_policies`.
"""

import os
import signal
import time
from pathlib import Path

import numpy as np

from tracked_env.benchmark.policy_interface import PolicyEntry

MARK = "TRACKED_ENV_TEST_MARK"  # names a file: that the first process has ended


class Constant:
    """The same action always; notes how it is called."""

    def __init__(self, left=0.3, right=0.3):
        self.action = (left, right)
        self.calls = []  # (state, episode_start)
        self.observations = []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls.append((state, np.array(episode_start)))
        self.observations.append(np.array(observation))
        return np.tile(np.float32(self.action), (len(observation), 1)), len(self.calls)


class Truthful(Constant):
    """Declares that it needs the truth, and keeps what it was told."""

    needs_truth = True

    def __init__(self):
        super().__init__()
        self.told = []

    def observe_truth(self, truth):
        self.told.append(truth)


class Curious(Constant):
    """Has the hook but does not declare it."""

    def observe_truth(self, truth):
        raise AssertionError("the truth was handed to a policy that does not declare it")


class WithContext(Constant):
    """A policy that wants to know the environment's clock."""

    def __init__(self, context):
        super().__init__()
        self.context = context


class Believing(Constant):
    """Believes what it was built with, whatever happens: {name: (value, standard deviation)}."""

    def __init__(self, believed, action=0.3):
        super().__init__(action, action)
        self.believed = believed

    def estimates(self):
        count = len(self.observations[-1])
        return {
            name: (np.full(count, value), np.full(count, deviation))
            for name, (value, deviation) in self.believed.items()
        }


class Tracking(Truthful):
    """Knows the truth but for a factor: value = factor * truth, with a claimed sigma.

    excited() and nis() follow its own clock: excited in every second call, NIS 2, 0, 2, 0 ...
    """

    def __init__(self, names, factor, sigma):
        super().__init__()
        self.action = (0.0, 0.0)
        self.names, self.factor, self.sigma = names, factor, sigma  # sigma as share of the truth

    def estimates(self):
        truth = self.told[-1]
        return {
            name: (self.factor * truth[name], self.sigma * np.abs(truth[name]))
            for name in self.names
        }

    def excited(self):
        return {self.names[0]: np.full(len(self.observations[-1]), len(self.calls) % 2 == 1)}

    def nis(self):
        return {"filter": np.full(len(self.observations[-1]), 2.0 * (len(self.calls) % 2))}


class Spin(Constant):
    """Turns on the spot, so that the reference leaves it behind."""

    def __init__(self):
        super().__init__(-0.9, 0.9)


def end_once():
    """End this process by a signal, the first time that any process gets here."""
    mark = Path(os.environ[MARK])
    try:
        mark.touch(exist_ok=False)
    except FileExistsError:
        return
    os.kill(os.getpid(), signal.SIGKILL)


class Mortal(Constant):
    """Ends its process in the third step of the first chunk, the first time."""

    def predict(self, *args, **kwargs):
        answer = super().predict(*args, **kwargs)
        if answer[1] == 3:
            end_once()
        return answer


class Deadly(Constant):
    """Ends its process always."""

    def predict(self, *args, **kwargs):
        os.kill(os.getpid(), signal.SIGKILL)
        return super().predict(*args, **kwargs)


class Wrong(Constant):
    """Raises an error in its third step."""

    def predict(self, *args, **kwargs):
        answer = super().predict(*args, **kwargs)
        if answer[1] == 3:
            raise KeyError("lacking")
        return answer


class Pausing(Constant):
    """On the node that a file `doomed` names: says that it is there, and waits for the end.

    On another node it waits until that has been said.
    """

    def predict(self, *args, **kwargs):
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


def trained_and_noted(place, job):
    """One training of several; a file says on which node of a Ray cluster it runs."""
    import ray

    import train

    node = ray.get_runtime_context().get_node_id()
    Path(place.folder, f"{job.name}.node").write_text(node)
    return train.train_one(place, job)


def sleep(shared, job):
    """A long job; the file says that it has begun."""
    Path(os.environ[MARK]).touch()
    time.sleep(job)


INSTANCE = Constant(0.1, 0.2)
NOTHING = 3


def entry(name, make, fingerprint="1"):
    return PolicyEntry(name, make, fingerprint)
