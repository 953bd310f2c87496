"""What the two regressions on the vehicle's motion share: memory, bounds, answers.

A regression turns a measurement into one equation per vehicle; least_squares takes it from
there. A sample that cannot be used (stale, standstill) holds, one with NaN is counted.
The parameters change by interacting models; with the table PLAIN there are none, as in the
regressions that are printed in S (`reproduce`).

Interacting models: least squares for two parameters that may rest, walk, or jump.

Four estimates of least_squares run side by side. They differ in the random walk that they expect of
the parameters, one row of a table each:
    calm    parameter 1 (of the vehicle) rests, parameter 2 (of the soil) hardly moves
    fast    the soil moves all the time
    border  the soil changes within a fraction of a second
    jump    the load changes, and parameter 1 with it
Before each sample the models exchange what they know, as a Markov chain prescribes that leaves
model i with rate 1 / s_i and enters j with a share pi_j; after it each has the odds of the
likelihood of that sample. With odds mu_i, estimates x_i, P_i and the transitions p_ij,
    c_j  = sum_i p_ij mu_i
    x_0j = sum_i p_ij mu_i x_i / c_j
    P_0j = sum_i p_ij mu_i (P_i + (x_i - x_0j)(x_i - x_0j)^T) / c_j + Q_j
    mu_j = c_j N(eps_j; 0, S_j) / sum
and the answer is the mean and the covariance of the mixture, so that doubts between the models are
part of what is claimed. It is kept as the estimate in block 0 of the memory.

    outliers  samples beyond 5 sigma are skipped, but from the PATIENCE-th in a row on they count,
              and the second does where its innovation is that of the first: two outliers that agree
              are a change, and the evidence is that of both
    trends    both parameters changing slowly look like neither model, and no innovation is large:
              a slower estimate watches, which knows no walk of parameter 1. Where the mean of its
              eps / sqrt(S) over TREND_TIME is not 0, parameter 1 of the calm model walks as well,
              for TREND_HELD. An alarm of the longitudinal regression is one of the turning one,
              an `evident` one of the turning regression is one of both where sideslip allows it

References: [1] H. A. P. Blom, Y. Bar-Shalom, IEEE Trans. Automatic Control 33 (1988) 780.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import least_squares
from baselines.estimators import least_squares as ls
from baselines.estimators.measurement import (
    ATTITUDE,
    AnsweringEstimator,
    DataSheet,
    Estimate,
    Estimator,
    Measurement,
    Quantity,
    attitude_of,
)
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters
from tracked_env.validation import VEHICLES, checked_whole

MODELS = 4
CALM, FAST, BORDER, JUMP = range(MODELS)
ALARMED, SLOW = MODELS, MODELS + 1  # rows of a table: the calm model during an alarm, the monitor
# Columns of a table. Walks: variances per sample, of parameter 1 over its square, of parameter 2
# in units of sigma_2^2. Leaving: chance per sample. Share: of the entries into a model.
WALK_1, WALK_2, LEAVING, SHARE = range(4)
AVERAGED, GATE = LEAVING, SHARE  # of the monitor: share of a sample in its mean, gate of an alarm

SOJOURNS = (10.0, 20.0, 0.3, 0.06)  # [s] mean, by model
SHARES = (0.8, 0.5, 0.045, 0.03)  # [-] of the entries that are not its own, by model
OUTLIER_GATE = 25.0  # [-] five standard deviations
PATIENCE = 3.0  # [samples] outliers in a row of which the last counts
AGREEMENT = 0.25  # [-] of an outlier's innovation by which that of the next one may differ
MOST_SQUARED = 1e12  # [-] normalised innovation squared that a sample may have
LEAST_EVIDENCE = -6.0  # [-] log of the likelihood ratio of one sample to the best model
TREND_TIME = 1.5  # [s] over which the monitor averages
TREND_HELD = 4.0  # [s] that an alarm lasts
EVIDENT = 16.0 / 9.0  # [-] times the gate: four standard deviations where the gate is three
HELD_GATE = 1.25  # [-] times the gate, while parameter 1 is held: little speaks for a trend of it
MOST_NORMALISED = 3.0  # [-] that a sample may count in that mean: a change is no trend
JUMPED = 0.1  # [-] odds of a jump from which on other estimators are told
RESTART = 0.3  # [-] odds of a border or jump from which on the monitor begins anew

# Blocks of `memory`, in columns: 0 is the mixture, then the models, then the monitor.
_FIRST, _MONITOR = least_squares.SIZE, least_squares.SIZE * (MODELS + 1)
ODDS = least_squares.PLAIN_MEMORY  # MODELS columns; all 0 before the first sample: calm
# Outliers in a row, innovation of the last one, mean of the monitor, seconds left of an alarm.
OUTLIERS, REFUSED, TREND, ALARM = range(ODDS + MODELS, ODDS + MODELS + 4)
MEMORY = ALARM + 1


def table(
    walks: Mapping[int, tuple[float, float]], gate: float, sigma_2: float, period: float
) -> NDArray[np.float64]:
    """The table (MODELS + 2, 4) of a regression.

    walks [1/sqrt(s)]: by row, of parameter 1 relative to itself, and of parameter 2. gate [-]:
    square of the monitor's mean, in units of its variance, that is an alarm. sigma_2: prior
    deviation of parameter 2. period [s]: between two samples.
    """
    rows = np.zeros((MODELS + 2, 4))
    for row, (walk_1, walk_2) in walks.items():
        rows[row, WALK_1] = walk_1 * walk_1 * period
        rows[row, WALK_2] = walk_2 * walk_2 * period / sigma_2**2
    for model in range(MODELS):
        rows[model, LEAVING] = min(period / SOJOURNS[model], 1.0)
        rows[model, SHARE] = SHARES[model]
    rows[SLOW, AVERAGED], rows[SLOW, GATE] = min(period / TREND_TIME, 1.0), gate
    return rows


@formula
def _exchange(memory, i, table):
    """The models exchange estimates and odds: x_0j, P_0j before the walk, and c_j."""
    shares = 0.0
    for j in range(MODELS):
        shares += table[j, SHARE]
    pool, m_1, m_2, m_11, m_12, m_22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(MODELS):
        left = memory[i, ODDS + j] * table[j, LEAVING] / (shares - table[j, SHARE])
        d_1, d_2, s_11, s_12, s_22 = least_squares.moments(
            memory, i, _FIRST + j * least_squares.SIZE
        )
        pool += left
        m_1, m_2 = m_1 + left * d_1, m_2 + left * d_2
        m_11, m_12, m_22 = m_11 + left * s_11, m_12 + left * s_12, m_22 + left * s_22
    for j in range(MODELS):
        h, share, odds = _FIRST + j * least_squares.SIZE, table[j, SHARE], memory[i, ODDS + j]
        left = odds * table[j, LEAVING] / (shares - share)
        # What comes of all models but j, and what stays.
        kept = odds * (1.0 - table[j, LEAVING]) - share * left
        chance = max(share * pool + kept, 1e-300)
        d_1, d_2, s_11, s_12, s_22 = least_squares.moments(memory, i, h)
        x_1, x_2 = (share * m_1 + kept * d_1) / chance, (share * m_2 + kept * d_2) / chance
        p_11 = (share * m_11 + kept * s_11) / chance - x_1 * x_1
        p_12 = (share * m_12 + kept * s_12) / chance - x_1 * x_2
        p_22 = (share * m_22 + kept * s_22) / chance - x_2 * x_2
        least_squares.put(
            memory,
            i,
            h,
            memory[i, least_squares.X_1] + x_1,
            memory[i, least_squares.X_2] + x_2,
            p_11,
            p_12,
            p_22,
        )
        memory[i, ODDS + j] = chance


@formula
def _age(memory, i, h, prior, table, row, hold_1):
    """Forgetting, unless parameter 1 is held, and the walk of one row of the table."""
    if not hold_1:
        least_squares.forget(memory, i, h, prior)
    least_squares.walk(memory, i, h, prior, table[row, WALK_1], table[row, WALK_2])


@formula
def _evidence(memory, i, j, sample, prior):
    """Log of the likelihood of the sample in model j, a constant apart."""
    error, gain = least_squares.innovation(
        memory, i, _FIRST + j * least_squares.SIZE, sample, prior
    )
    spread = gain + sample.variance
    return -0.5 * (min(error * error / spread, MOST_SQUARED) + math.log(spread))


@formula
def mix(memory, i):
    """The mixture of the models becomes the estimate in block 0."""
    total, x_1, x_2 = 0.0, 0.0, 0.0
    for j in range(MODELS):
        h, odds = _FIRST + j * least_squares.SIZE, memory[i, ODDS + j]
        total += odds
        x_1, x_2 = (
            x_1 + odds * memory[i, h + least_squares.X_1],
            x_2 + odds * memory[i, h + least_squares.X_2],
        )
    memory[i, least_squares.X_1], memory[i, least_squares.X_2] = x_1 / total, x_2 / total
    p_11, p_12, p_22 = 0.0, 0.0, 0.0
    for j in range(MODELS):
        share = memory[i, ODDS + j] / total
        memory[i, ODDS + j] = share
        _d_1, _d_2, s_11, s_12, s_22 = least_squares.moments(
            memory, i, _FIRST + j * least_squares.SIZE
        )
        p_11, p_12, p_22 = p_11 + share * s_11, p_12 + share * s_12, p_22 + share * s_22
    least_squares.put(
        memory, i, 0, memory[i, least_squares.X_1], memory[i, least_squares.X_2], p_11, p_12, p_22
    )


@formula
def _learn(memory, i, sample, prior, table, hold_1, least):
    """Take the sample into every model and into their odds; least: LEAST_EVIDENCE per sample that
    it stands for."""
    alarmed = memory[i, ALARM] > 0.0
    for j in range(MODELS):
        row = ALARMED if j == CALM and alarmed else j
        _age(memory, i, _FIRST + j * least_squares.SIZE, prior, table, row, hold_1)
    calm, fast = (
        _evidence(memory, i, CALM, sample, prior),
        _evidence(memory, i, FAST, sample, prior),
    )
    border = _evidence(memory, i, BORDER, sample, prior)
    jump = _evidence(memory, i, JUMP, sample, prior)
    best = max(calm, fast, border, jump)
    memory[i, ODDS + CALM] *= math.exp(max(calm - best, least))
    memory[i, ODDS + FAST] *= math.exp(max(fast - best, least))
    memory[i, ODDS + BORDER] *= math.exp(max(border - best, least))
    memory[i, ODDS + JUMP] *= math.exp(max(jump - best, least))
    for j in range(MODELS):
        h = _FIRST + j * least_squares.SIZE
        error, _gain = least_squares.innovation(memory, i, h, sample, prior)
        least_squares.learn(memory, i, h, sample, prior, error, hold_1)


@formula
def _trend_squared(memory, i, table):
    """Square of the monitor's mean, in units of its variance."""
    share = table[SLOW, AVERAGED]
    return memory[i, TREND] * memory[i, TREND] * (2.0 - share) / share


@formula
def _watch(memory, i, sample, prior, table, hold_1):
    """The monitor of slow trends takes the sample."""
    share, left = table[SLOW, AVERAGED], memory[i, ALARM]
    memory[i, ALARM] = max(left - share * TREND_TIME, 0.0)
    ends = left > 0.0 and memory[i, ALARM] == 0.0
    if ends or memory[i, ODDS + BORDER] + memory[i, ODDS + JUMP] > RESTART:
        for k in range(least_squares.SIZE):
            memory[i, _MONITOR + k] = memory[i, k]
        memory[i, TREND] = 0.0
    _age(memory, i, _MONITOR, prior, table, SLOW, hold_1)
    error, gain = least_squares.innovation(memory, i, _MONITOR, sample, prior)
    normalised = error / math.sqrt(gain + sample.variance)
    normalised = min(max(normalised, -MOST_NORMALISED), MOST_NORMALISED)
    memory[i, TREND] += share * (normalised - memory[i, TREND])
    squared = _trend_squared(memory, i, table)
    smallest, _largest = least_squares.eigenvalues(memory, i)
    determined = smallest >= least_squares.EXCITED
    gate = table[SLOW, GATE] * (HELD_GATE if hold_1 else 1.0)
    if squared > gate and memory[i, ALARM] == 0.0 and determined:
        memory[i, ALARM] = TREND_HELD
    least_squares.learn(memory, i, _MONITOR, sample, prior, error, hold_1)


@formula
def wait(memory, i, prior, table):
    """A control step without a sample. During an alarm parameter 2 is taken to walk on, as fast as
    it can; else nothing is known to change, and all is kept."""
    if memory[i, ALARM] <= 0.0 or memory[i, ODDS] == 0.0:
        return
    memory[i, ALARM] = max(memory[i, ALARM] - table[SLOW, AVERAGED] * TREND_TIME, 0.0)
    for k in range(MODELS + 1):
        least_squares.walk(
            memory, i, _FIRST + k * least_squares.SIZE, prior, 0.0, table[FAST, WALK_2]
        )
    mix(memory, i)


@formula
def learn_apart(memory, i, sample, prior):
    """Take an equation on parameter 1 into all models, not into the monitor; it ages nothing."""
    for k in range(MODELS):
        h = _FIRST + k * least_squares.SIZE
        error, _gain = least_squares.innovation(memory, i, h, sample, prior)
        least_squares.learn(memory, i, h, sample, prior, error, False)
    mix(memory, i)


@formula
def watched(memory, i, prior):
    """(theta_1, its variance) as the monitor has them, which takes no equation apart."""
    p_11, _p_12, _p_22 = least_squares.covariance_gaussian_blocks(memory, i, _MONITOR)
    theta_1 = prior.mean_1 + prior.sigma_1 * memory[i, _MONITOR + least_squares.X_1]
    return max(theta_1, prior.low_1), p_11 * prior.sigma_1 * prior.sigma_1


@formula
def jumped(memory, i):
    """Whether parameter 1 of vehicle i is seen to jump in this control step."""
    return memory[i, ODDS + JUMP] > JUMPED


@formula
def let_jump(memory, i, prior, table):
    """Something outside says that the parameters of vehicle i have jumped."""
    for k in range(MODELS + 1):
        least_squares.walk(
            memory,
            i,
            _FIRST + k * least_squares.SIZE,
            prior,
            table[JUMP, WALK_1],
            table[JUMP, WALK_2],
        )
    mix(memory, i)


@formula
def evident(memory, i, table):
    """Whether the trend that the monitor of vehicle i sees is beyond the usual doubt."""
    return _trend_squared(memory, i, table) > EVIDENT * table[SLOW, GATE]


@formula
def share_alarm(memory, other, i):
    """An alarm of the `other` regression on vehicle i is one of this one, too."""
    memory[i, ALARM] = max(memory[i, ALARM], other[i, ALARM])


@formula
def _refuse(memory, i, error, nis, variance):
    """Whether a sample is refused as an outlier, and how many samples it stands for."""
    if nis <= OUTLIER_GATE:
        memory[i, OUTLIERS] = memory[i, REFUSED] = 0.0
        return False, 1.0
    before = memory[i, REFUSED]
    apart = abs(error - before) - 3.0 * math.sqrt(2.0 * variance)
    second = memory[i, OUTLIERS] == 1.0 and apart < AGREEMENT * abs(before)
    memory[i, OUTLIERS] = PATIENCE if second else memory[i, OUTLIERS] + 1.0
    memory[i, REFUSED] = error
    return memory[i, OUTLIERS] < PATIENCE, 2.0 if second else 1.0


@formula
def step(memory, i, sample, prior, table):
    """Take one sample of vehicle i. Returns (status, eps^2 / S): status as estimate.Status.

    Status 1 (holding) when the sample gains nothing or some direction is not excited.
    """
    error, gain = least_squares.innovation(memory, i, 0, sample, prior)
    total = gain + sample.variance
    nis = error * error / total
    status = 1
    if not math.isfinite(nis + total):
        memory[i, least_squares.SKIPPED] += 1.0
        status = 2
    elif gain > least_squares.GAIN_GATE * sample.variance:
        refused, weight = _refuse(memory, i, error, nis, sample.variance)
        if refused:
            status = 2
        else:
            hold_1 = least_squares.noise_alone(memory, i, sample, prior)
            if memory[i, ODDS] == 0.0:
                memory[i, ODDS + CALM] = 1.0
            _exchange(memory, i, table)
            _learn(memory, i, sample, prior, table, hold_1, weight * LEAST_EVIDENCE)
            mix(memory, i)
            _watch(memory, i, sample, prior, table, hold_1)
            smallest, _largest = least_squares.eigenvalues(memory, i)
            status = 0 if smallest >= least_squares.EXCITED and not hold_1 else 1
    return status, nis


CONVERGING, HOLDING, REJECTED = 0, 1, 2  # of estimate.Status, as plain numbers for kernels
TORQUE_MARGIN = 1.5  # [-] of the drives' limit: a larger torque is not one, and would weigh much
SLOWEST = 0.2  # [m/s] slower tracks may be held by the soil, and say nothing about it
# Columns of the answer of a kernel, per vehicle.
(
    VALUE_1, VALUE_2, P_11, P_12, P_22, EXCITATION, CONDITION, STATUS, NIS, SKIPPED,
) = range(10)  # fmt: skip
ANSWER = 10
PLAIN = np.empty((0, 4))  # no table of models


@formula
def take(memory, i, sample, prior, table):
    """One sample of vehicle i, by interacting models where there is a table (R, 4) of them."""
    if table.shape[0] > 0:
        return step(memory, i, sample, prior, table)
    return ls.step(memory, i, sample, prior)


@formula
def answer(memory, i, prior, status, nis, out):
    """Write what is known of vehicle i into out (N, ANSWER)."""
    out[i, VALUE_1], out[i, VALUE_2] = ls.values(memory, i, prior)
    out[i, P_11], out[i, P_12], out[i, P_22] = ls.covariance(memory, i, prior)
    smallest, largest = ls.eigenvalues(memory, i)
    out[i, EXCITATION] = smallest
    out[i, CONDITION] = largest / smallest if smallest > 0.0 else np.inf
    out[i, STATUS] = status
    out[i, NIS] = nis
    out[i, SKIPPED] = memory[i, ls.SKIPPED]


@loop
def read_all(memory, prior, out):
    """The present answer of every vehicle, without a sample."""
    for i in range(memory.shape[0]):
        answer(memory, i, prior, HOLDING, np.nan, out)


def checked_forgetting(name: str, value: float) -> float:
    """A forgetting factor. Raises ValueError outside (0.5, 1]."""
    if not 0.5 < value <= 1.0:
        raise ValueError(
            f"{name} = {value}; must be in (0.5, 1]. It is the share of old information that is "
            "kept per sample: 0.998 remembers about 500 samples. Did you pass 1 - lambda?"
        )
    return float(value)


class TwoParameterEstimator(AnsweringEstimator):
    """Forgetting least squares for two parameters of N vehicles.

    parameters: nominal ones, the prior mean. control_period [s]. data_sheet: noise of the
    sensors. count: vehicles. table: of the interacting models, PLAIN without them. Subclasses name
    the parameters and give prior, table and kernel.
    Raises ValueError for a period, count or forgetting factor that makes no sense.
    """

    names: tuple[str, ...]
    provides: tuple[Quantity, ...]
    needs: tuple[str, ...]
    paired = True
    columns = MEMORY  # of the memory
    _kernel: Callable[..., None]

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet | None,
        count: int,
        prior: ls.Prior,
        table: NDArray[np.float64],
    ) -> None:
        count = checked_whole("count", count, VEHICLES)
        self.parameters = PlantParameters(*(float(value) for value in parameters))
        self.control_period = control_period
        self.data_sheet = DataSheet() if data_sheet is None else data_sheet
        self.prior = ls.Prior._make(float(x) for x in prior)
        self.table = table
        self.memory = np.zeros((count, self.columns))
        self.answer = np.empty((0, ANSWER))  # of the last sample

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        self.memory[slice(None) if rows is None else np.asarray(rows)] = 0.0

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """Nothing is needed of other estimators."""

    def on_slopes(self) -> Self:
        """The same, which reads the attitude as well; returns itself."""
        self.needs = (*type(self).needs, *ATTITUDE)
        return self

    def known(self) -> tuple[Any, ...]:
        """What the kernel needs besides the measurement."""
        return ()

    def expect_constants(self) -> None:
        """From now on nothing is forgotten, and no parameter is expected to change."""
        self.table = self.table[:0]
        self.prior = self.prior._replace(forgetting=1.0)

    def compute(self, measurement: Measurement) -> NDArray[np.float64]:
        """Take one sample; returns the bare answer (N, ANSWER), which is kept in `answer` too."""
        self.answer = out = np.empty((len(self.memory), ANSWER))
        type(self)._kernel(
            measurement.values, measurement.fresh, attitude_of(measurement), self.memory,
            self.prior, self.table, *self.known(), out,
        )  # fmt: skip
        return out

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle.

        Raises ValueError when the measurement is of another number of vehicles.
        """
        if len(measurement.values) != len(self.memory):
            raise ValueError(
                f"measurement of {len(measurement.values)} vehicles for an estimator of "
                f"{len(self.memory)}"
            )
        return self.estimate(self.compute(measurement))

    def read(self) -> Estimate:
        """What is known now, without a sample."""
        return self.estimate(self.answer_now())

    def answer_now(self) -> NDArray[np.float64]:
        """The bare answer (N, ANSWER) without a sample."""
        out = np.empty((len(self.memory), ANSWER))
        read_all(self.memory, self.prior, out)
        return out

    def estimate(self, answer: NDArray[np.float64]) -> Estimate:
        """The answer of the kernel as an Estimate."""
        out = answer
        covariance = out[:, [P_11, P_12, P_12, P_22]].reshape(-1, 2, 2)
        return Estimate(
            self.names,
            out[:, :2],
            covariance,
            out[:, EXCITATION],
            out[:, CONDITION],
            out[:, STATUS].astype(np.int64),
            out[:, NIS],
            out[:, SKIPPED].astype(np.int64),
        )
