"""Interacting models: least squares for two parameters that may rest, walk, or jump.

Four estimates of least_squares run side by side. They differ in the random walk that they expect of
the parameters, one row of a table each:
    calm    parameter 1 (of the vehicle) rests, parameter 2 (of the soil) hardly moves
    fast    the soil moves all the time
    border  the soil changes within a fraction of a second
    jump    the load changes, and parameter 1 with it
Before each sample the models exchange their estimates, as a Markov chain prescribes that leaves
model i with rate 1 / s_i and enters j with a share pi_j; after it each has the odds of the
likelihood of that sample. With odds mu_i, estimates x_i, P_i and the transitions p_ij,
    c_j  = sum_i p_ij mu_i
    x_0j = sum_i p_ij mu_i x_i / c_j
    P_0j = sum_i p_ij mu_i (P_i + (x_i - x_0j)(x_i - x_0j)^T) / c_j + Q_j
    mu_j = c_j N(eps_j; 0, S_j) / sum
and the answer is the mean and the covariance of the mixture, so that doubts between the models are
part of the claimed covariance. Without a table (PLAIN) there is one estimate, as S prints it.

    outliers  samples beyond 5 sigma are skipped, but from the PATIENCE-th in a row on they count,
              and the second does where its innovation is that of the first: two outliers that agree
              are a change, and the evidence is that of both
    trends    both parameters changing slowly look like neither model, and no innovation is large.
              A slower estimate, the monitor, assumes that parameter 1 does not change. If the mean
              of its eps / sqrt(S) over TREND_TIME differs from 0, an alarm lets parameter 1 of the
              calm model walk as well for ALARM_TIME. An alarm of the longitudinal regression also
              raises one in the turning regression. In the other direction only a trend beyond
              EVIDENT gates does, and only where the equation of the side slip holds

References: [1] H. A. P. Blom, Y. Bar-Shalom, IEEE Trans. Automatic Control 33 (1988) 780.
[S] Strawa et al., Electronics 10 (2021) 187, section 7.1.1.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import least_squares as ls
from baselines.estimators.measurement import (
    CONVERGING,
    HOLDING,
    REJECTED,
    BatchEstimator,
    Estimate,
    Measurement,
    make_measurement,
)
from tracked_env.physics.jit import formula

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
ALARM_TIME = 4.0  # [s] that an alarm lasts
EVIDENT = 16.0 / 9.0  # [-] times the gate: four standard deviations where the gate is three
UNEXCITED_GATE = 1.25  # [-] times the gate where parameter 1 is not learned: weak evidence
MOST_NORMALISED = 3.0  # [-] that a sample may count in that mean: a change is no trend
FORGETTING = 0.9995  # [-] per sample: at 50 Hz 40 s
JUMPED = 0.1  # [-] odds of a jump that also let the turning regression jump
RESTART = 0.3  # [-] odds of a border or jump from which on the monitor begins anew

PLAIN = np.empty((0, 4))  # no table of models
MIXTURE, FIRST, MONITOR = 0, 1, MODELS + 1  # among the estimates of a row; the models begin at 1

# The state of one vehicle in a regression, one row of its memory.
ROW = np.dtype([
    ("estimates", ls.ESTIMATE, MODELS + 2),
    ("skipped", float),  # samples with NaN
    ("variation", float),  # [-] of phi_1 against phi_2
    ("odds", float, MODELS), ("evidence", float, MODELS),  # all 0 before the first sample
    ("outliers", float),  # in a row
    ("refused", float),  # innovation of the last of them
    ("trend", float),  # [-] mean of the monitor
    ("alarm", float),  # [s] left
    # of the turning regression alone
    ("turned", float), ("belts", float),  # means of (w B)^2 and w B (belt_R - belt_L)
    ("agreement", float),  # [-] of the side slip with a friction that is not shared; 0: unknown
    ("cohesive", float),  # [s] of turning left on cohesive soil
    ("beyond", float),  # [s] beyond friction
    ("since_note", float),  # [s] since the inertia was noted
    ("last_mean", float), ("last_information", float),  # the last note, in units of the prior
    ("earlier_mean", float), ("earlier_information", float),  # the one before
])  # fmt: skip


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
def _moments(row, e):
    """Mean and second moments of e about the mixture's mean: (d_1, d_2, M_11, M_12, M_22)."""
    p_11, p_12, p_22 = ls.scaled_covariance(e)
    mixture = row.estimates[MIXTURE]
    d_1, d_2 = e.x_1 - mixture.x_1, e.x_2 - mixture.x_2
    return d_1, d_2, p_11 + d_1 * d_1, p_12 + d_1 * d_2, p_22 + d_2 * d_2


@formula
def _exchange(row, table):
    """The models exchange estimates and odds: x_0j, P_0j before the walk, and c_j."""
    shares = 0.0
    for j in range(MODELS):
        shares += table[j, SHARE]
    pool, m_1, m_2, m_11, m_12, m_22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(MODELS):
        left = row.odds[j] * table[j, LEAVING] / (shares - table[j, SHARE])
        d_1, d_2, s_11, s_12, s_22 = _moments(row, row.estimates[FIRST + j])
        pool += left
        m_1, m_2 = m_1 + left * d_1, m_2 + left * d_2
        m_11, m_12, m_22 = m_11 + left * s_11, m_12 + left * s_12, m_22 + left * s_22
    mixture = row.estimates[MIXTURE]
    for j in range(MODELS):
        share, odds = table[j, SHARE], row.odds[j]
        left = odds * table[j, LEAVING] / (shares - share)
        # What comes of all models but j, and what stays.
        stays = odds * (1.0 - table[j, LEAVING]) - share * left
        chance = max(share * pool + stays, 1e-300)
        model = row.estimates[FIRST + j]
        d_1, d_2, s_11, s_12, s_22 = _moments(row, model)
        x_1, x_2 = (share * m_1 + stays * d_1) / chance, (share * m_2 + stays * d_2) / chance
        p_11 = (share * m_11 + stays * s_11) / chance - x_1 * x_1
        p_12 = (share * m_12 + stays * s_12) / chance - x_1 * x_2
        p_22 = (share * m_22 + stays * s_22) / chance - x_2 * x_2
        ls.set_gaussian(model, mixture.x_1 + x_1, mixture.x_2 + x_2, p_11, p_12, p_22)
        row.odds[j] = chance


@formula
def _age(e, prior, table, model, hold_1):
    """Forgetting, unless parameter 1 is held, and the walk of one row of the table."""
    if not hold_1:
        ls.forget(e, prior)
    ls.walk(e, prior, table[model, WALK_1], table[model, WALK_2])


@formula
def mix(row):
    """The mixture of the models becomes the estimate of the row."""
    total, x_1, x_2 = 0.0, 0.0, 0.0
    for j in range(MODELS):
        model, odds = row.estimates[FIRST + j], row.odds[j]
        total += odds
        x_1, x_2 = x_1 + odds * model.x_1, x_2 + odds * model.x_2
    mixture = row.estimates[MIXTURE]
    mixture.x_1, mixture.x_2 = x_1 / total, x_2 / total
    p_11, p_12, p_22 = 0.0, 0.0, 0.0
    for j in range(MODELS):
        share = row.odds[j] / total
        row.odds[j] = share
        _d_1, _d_2, s_11, s_12, s_22 = _moments(row, row.estimates[FIRST + j])
        p_11, p_12, p_22 = p_11 + share * s_11, p_12 + share * s_12, p_22 + share * s_22
    ls.set_gaussian(mixture, mixture.x_1, mixture.x_2, p_11, p_12, p_22)


@formula
def _learn(row, sample, prior, table, hold_1, least):
    """Take the sample into every model and into their odds; least: LEAST_EVIDENCE per sample that
    it stands for."""
    for j in range(MODELS):
        walks = ALARMED if j == CALM and row.alarm > 0.0 else j
        _age(row.estimates[FIRST + j], prior, table, walks, hold_1)
    best = -math.inf
    for j in range(MODELS):  # log of the likelihood, a constant apart
        error, gain = ls.innovation(row.estimates[FIRST + j], sample, prior)
        spread = gain + sample.variance
        squared = min(error * error / spread, MOST_SQUARED)
        row.evidence[j] = -0.5 * (squared + math.log(spread))
        best = max(best, row.evidence[j])
    for j in range(MODELS):
        row.odds[j] *= math.exp(max(row.evidence[j] - best, least))
        ls.learn(row.estimates[FIRST + j], sample, prior, hold_1)


@formula
def _trend_squared(row, table):
    """Square of the monitor's mean, in units of its variance."""
    share = table[SLOW, AVERAGED]
    return row.trend * row.trend * (2.0 - share) / share


@formula
def _watch(row, sample, prior, table, hold_1):
    """The monitor of slow trends takes the sample."""
    share, left = table[SLOW, AVERAGED], row.alarm
    row.alarm = max(left - share * TREND_TIME, 0.0)
    ends = left > 0.0 and row.alarm == 0.0
    mixture, monitor = row.estimates[MIXTURE], row.estimates[MONITOR]
    if ends or row.odds[BORDER] + row.odds[JUMP] > RESTART:
        monitor.x_1, monitor.x_2 = mixture.x_1, mixture.x_2
        monitor.j_11, monitor.j_12, monitor.j_22 = mixture.j_11, mixture.j_12, mixture.j_22
        row.trend = 0.0
    _age(monitor, prior, table, SLOW, hold_1)
    error, gain = ls.innovation(monitor, sample, prior)
    normalised = error / math.sqrt(gain + sample.variance)
    normalised = min(max(normalised, -MOST_NORMALISED), MOST_NORMALISED)
    row.trend += share * (normalised - row.trend)
    smallest, _largest = ls.excitations(mixture)
    gate = table[SLOW, GATE] * (UNEXCITED_GATE if hold_1 else 1.0)
    beyond = _trend_squared(row, table) > gate
    if beyond and row.alarm == 0.0 and smallest >= ls.EXCITED:
        row.alarm = ALARM_TIME
    ls.learn(monitor, sample, prior, hold_1)


@formula
def walk_all(row, prior, walk_1, walk_2):
    """All models, and the mixture before, walk by these variances per step: parameters have jumped,
    as another regression says, or time passes without a sample."""
    for k in range(MODELS + 1):
        ls.walk(row.estimates[FIRST + k], prior, walk_1, walk_2)
    mix(row)


@formula
def wait(row, prior, table):
    """A control step without a sample. During an alarm parameter 2 is taken to walk on, as fast as
    it can; else nothing is assumed to change."""
    if row.alarm <= 0.0 or row.odds[0] == 0.0:
        return
    row.alarm = max(row.alarm - table[SLOW, AVERAGED] * TREND_TIME, 0.0)
    walk_all(row, prior, 0.0, table[FAST, WALK_2])


@formula
def learn_apart(row, sample, prior):
    """Take an equation on parameter 1 into all models, not into the monitor; it ages nothing."""
    for k in range(MODELS):
        ls.learn(row.estimates[FIRST + k], sample, prior, False)
    mix(row)


@formula
def watched(row, prior):
    """(theta_1, its variance) of the monitor, which does not see the equations of learn_apart."""
    monitor = row.estimates[MONITOR]
    p_11, _p_12, _p_22 = ls.scaled_covariance(monitor)
    theta_1 = prior.mean_1 + prior.sigma_1 * monitor.x_1
    return max(theta_1, prior.low_1), p_11 * prior.sigma_1 * prior.sigma_1


@formula
def evident(row, table):
    """Whether the trend that the monitor sees is beyond the usual doubt."""
    return _trend_squared(row, table) > EVIDENT * table[SLOW, GATE]


@formula
def _refuse(row, error, nis, variance):
    """Whether a sample is refused as an outlier, and how many samples it stands for."""
    if nis <= OUTLIER_GATE:
        row.outliers = row.refused = 0.0
        return False, 1.0
    before = row.refused
    apart = abs(error - before) - 3.0 * math.sqrt(2.0 * variance)
    second = row.outliers == 1.0 and apart < AGREEMENT * abs(before)
    row.outliers = PATIENCE if second else row.outliers + 1.0
    row.refused = error
    return row.outliers < PATIENCE, 2.0 if second else 1.0


@formula
def take(row, sample, prior, table):
    """Take one sample of one vehicle. Returns (status, eps^2 / S): status as measurement.Status.
    Holding when the sample gains nothing or some direction is not excited."""
    mixture = row.estimates[MIXTURE]
    error, gain = ls.innovation(mixture, sample, prior)
    total = gain + sample.variance
    nis = error * error / total
    if not math.isfinite(nis + total):
        row.skipped += 1.0
        return REJECTED, nis
    if gain <= ls.GAIN_GATE * sample.variance:
        return HOLDING, nis
    if table.shape[0] > 0:
        refused, weight = _refuse(row, error, nis, sample.variance)
        if refused:
            return REJECTED, nis
        hold_1 = ls.noise_alone(row, mixture, sample, prior)
        if row.odds[0] == 0.0:
            row.odds[CALM] = 1.0
        _exchange(row, table)
        _learn(row, sample, prior, table, hold_1, weight * LEAST_EVIDENCE)
        mix(row)
        _watch(row, sample, prior, table, hold_1)
    else:
        hold_1 = ls.noise_alone(row, mixture, sample, prior)
        if not hold_1:
            ls.forget(mixture, prior)
        ls.learn(mixture, sample, prior, hold_1)
    smallest, _largest = ls.excitations(mixture)
    return CONVERGING if smallest >= ls.EXCITED and not hold_1 else HOLDING, nis


@formula
def write_answer(row, prior, status, nis, out):
    """Write the estimate of one vehicle into `out`, an answer_row."""
    e, p = row.estimates[MIXTURE], out.covariance
    out.value[0], out.value[1] = ls.values(e, prior)
    p[0, 0], p[0, 1], p[1, 1] = ls.covariance(e, prior)
    p[1, 0] = p[0, 1]
    smallest, largest = ls.excitations(e)
    out.excitation = smallest
    out.condition = largest / smallest if smallest > 0.0 else np.inf
    out.status, out.nis, out.skipped = status, nis, row.skipped


class TwoParameterEstimator(BatchEstimator):
    """Forgetting least squares for two parameters of N vehicles.

    A regression turns a measurement into one equation per vehicle. A sample that cannot be used
    (stale, standstill) holds, one with NaN is counted. Subclasses name the parameters and give
    prior, kernel and table of the interacting models (PLAIN: none).
    """

    row = ROW
    reads_attitude = True
    prior: ls.Prior
    table: NDArray[np.float64]
    _constants: Any

    def expect_constants(self) -> None:
        """From now on nothing is forgotten, and no parameter is expected to change."""
        self.table, self.prior = PLAIN, self.prior._replace(forgetting=1.0)

    def inputs(self, measurement: Measurement) -> tuple[Any, ...]:
        """Samples, state, and the constants of the equation."""
        samples = measurement.values, measurement.fresh, measurement.attitude
        return samples, self.rows, self.prior, self.table, self._constants

    def read(self) -> Estimate:
        """The present estimate, without a sample."""
        return self.update(make_measurement(fresh=False, v_x=np.zeros(len(self.memory))))
