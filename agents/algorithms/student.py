"""A student of a privileged teacher: regression of the hidden parameters on past samples.

It is chosen by `--augmentation student`, not by `--agent`: its network is that of its teacher,
whatever algorithm trained that one. The training itself: `agents.training.student_learner`.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro.conf

from agents.algorithms.algorithm import Algorithm
from agents.algorithms.settings import check

if TYPE_CHECKING:
    from agents.training.learner import Learner
    from agents.training.run import Run


@dataclass(frozen=True)
class StudentSettings:
    """Settings of augmentation student: how the inference of the hidden parameters is regressed."""

    n_steps: int = 64
    """Control steps per vehicle between two regressions."""

    gradient_steps: int = 20
    """Gradient steps of a regression, for 4096 new samples of 64 vehicles."""

    batch_size: int = 1024
    """Samples of one gradient step, of all that the buffer holds."""

    buffer_size: int = 200_000
    """Samples kept, the latest 62 s of 64 vehicles; 100 MB."""

    learning_rate: float = 1e-3
    """At the start; it falls linearly towards 0 over the training."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers."""

    lstm_hidden: Annotated[int | None, tyro.conf.arg(metavar="INTEGER")] = None
    """Units of an LSTM that sees `features` instead of past samples, and infers the true motion
    too, for a teacher that was trained with ideal sensors; without: none. It is regressed on
    sequences of n_steps, of which batch_size / n_steps make a gradient step."""

    features: Literal["reckoned", "estimates"] = "reckoned"
    """What the LSTM sees besides the observation: dead reckoning, or, on Torque-v0, the filtered
    motion and the parameters that the adaptive controller identifies."""

    def __post_init__(self) -> None:
        check(self)


def learner_of(run: "Run") -> "Learner":
    """A student of the teacher of a run. Raises ValueError."""
    # They import the archives.
    from agents.training.recurrent_student_learner import RecurrentStudentLearner
    from agents.training.student_learner import StudentLearner

    return (RecurrentStudentLearner if run.settings.lstm_hidden else StudentLearner)(run)


STUDENT_ALGORITHM = Algorithm(
    None, StudentSettings, learner_of, steps=500_000, network="that of its teacher"
)
