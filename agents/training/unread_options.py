"""Options of train.py that the training asked for would not read: refused where they are given.

Settings belong to the algorithm whose name they begin with, a few options to an augmentation.
"""

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

from agents.algorithms import ALGORITHMS
from agents.training.options import Options
from baselines.learned.augmentation import KINDS
from baselines.learned.privileged_inputs import STUDENT_FEATURES
from baselines.learned.recipe import STUDENT

# Options that only some kinds of augmentation have, see `agents.training.options`.
_OF_AUGMENTATION = {
    "lags": ("history", STUDENT), "residual_scale": ("residual",), "base": ("residual",),
    "trust": (STUDENT,), "data_sheet": (*KINDS, STUDENT),
}  # fmt: skip
_RENAMED = {"--memory": "--augmentation"}  # former names of options


def _refuse_setting(option: str, name: str, options: Options) -> None:
    """Raises ValueError for a setting of `name` where something else learns."""
    chosen = STUDENT if options.augmentation == STUDENT else options.algorithm
    if name == chosen:
        return
    instead = f"--augmentation {STUDENT}" if name == STUDENT else f"--agent {name}"
    learns = "a student, which has the network of its teacher" if chosen == STUDENT else chosen
    raise ValueError(
        f"--{option} has no effect: it is a setting of {name}, and what learns is {learns}. Give "
        f"{instead}, or leave it out"
    )


def _changed(settings: Any) -> Iterator[str]:
    """Names of the settings that have another value than by default."""
    usual = type(settings)()
    for setting in fields(settings):
        if getattr(settings, setting.name) != getattr(usual, setting.name):
            yield setting.name.replace("_", "-")


def check_read(options: Options) -> None:
    """Raises ValueError for an option that has another value than by default, and no effect."""
    for option, kinds in _OF_AUGMENTATION.items():
        value = getattr(options, option)
        if value not in (None, False) and options.augmentation not in kinds:
            raise ValueError(
                f"--{option.replace('_', '-')} has no effect with augmentation "
                f"{options.augmentation}: it is an option of augmentation {' and '.join(kinds)}. "
                f"Give --augmentation {kinds[0]}, or leave it out"
            )
    if options.lags is not None and options.student.lstm_hidden is not None:
        raise ValueError(
            f"--lags has no effect with --student.lstm-hidden {options.student.lstm_hidden}: that "
            f"student sees {options.student.features} instead of past samples. Leave one of them "
            "out"
        )
    if options.student.features != STUDENT_FEATURES[0] and options.student.lstm_hidden is None:
        raise ValueError(
            f"--student.features {options.student.features} has no effect without an LSTM: that "
            "student sees past samples. Give --student.lstm-hidden 64 too, or leave it out"
        )
    for name in (*ALGORITHMS, STUDENT):
        for setting in _changed(getattr(options, name.replace("-", "_"))):
            _refuse_setting(f"{name}.{setting}", name, options)


def check_given(arguments: Sequence[str], options: Options) -> None:
    """Raises ValueError for a setting on the command line that has no effect, default or not."""
    for word in arguments:
        name, dot, setting = word.removeprefix("--").partition("=")[0].partition(".")
        name = name.replace("_", "-")
        if word.startswith("--") and dot and (name in ALGORITHMS or name == STUDENT):
            _refuse_setting(f"{name}.{setting}", name, options)


def check_names(arguments: Sequence[str]) -> None:
    """Raises ValueError for an option by a former name, and says the one of today."""
    for word in arguments:
        former, _, _ = word.partition("=")
        if former in _RENAMED:
            raise ValueError(f"{former} is called {_RENAMED[former]} now, with the same values")
