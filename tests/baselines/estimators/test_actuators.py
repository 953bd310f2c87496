"""Estimator of the drives: exact on exact data, honest under noise, silent at the soil's limit."""

import numpy as np
import pytest

from baselines.estimators.actuators import ActuatorEstimator
from baselines.estimators.measurement import DataSheet, Status, make_measurement
from tracked_env.physics.parameters import VEHICLES

PERIOD = 0.02
NOMINAL = VEHICLES["strawa"]
LIMIT, RADIUS = NOMINAL.torque_limit, NOMINAL.sprocket_radius
EXACT = DataSheet(torque_noise=0.0, sprocket_speed_noise=0.0)
SIDES = ("left", "right")


def commands(steps, count=1, seed=0):
    """Actions (T, N, 2) as a controller gives them: slow manoeuvres, and jitter."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(steps)[:, None, None]
    rate, phase = rng.uniform(0.5, 2.0, (1, count, 2)), rng.uniform(0.0, 6.0, (1, count, 2))
    slow = 0.3 + 0.2 * np.sin(rate * time + phase)
    return (slow + 0.02 * rng.standard_normal((steps, count, 2))).astype(np.float32)


def torques(actions, gain, lag):
    """(T + 1, N, 2) [N m] that drives give: gain (T, N, 2) or less, lag (N,) or a number [s]."""
    decay = np.exp(-PERIOD / np.asarray(lag, dtype=float)).reshape(-1, 1)
    drive_torques = np.zeros((len(actions) + 1, *actions.shape[1:]))
    demand = LIMIT * actions * np.broadcast_to(gain, actions.shape)
    for k in range(len(actions)):
        drive_torques[k + 1] = decay * drive_torques[k] + (1.0 - decay) * demand[k]
    return drive_torques


class Bench:
    """Drives on a test bench: `run` shows the estimator what sensors would, step by step."""

    def __init__(self, count=1, sheet=EXACT, seed=1):
        self.estimator = ActuatorEstimator(NOMINAL, PERIOD, sheet, count)
        self.sheet, self.rng = sheet, np.random.default_rng(seed)

    def run(self, actions, soil_torques, belts=1.0, v_x=1.0, delay=0, fresh=None):
        """Estimates after each step; shown (T + 1, N, 2) [N m] torques at the soil.

        belts [m/s] a number or (T + 1, N, 2); delay [control steps] of all samples.
        """
        belts = np.broadcast_to(belts, soil_torques.shape)
        noise = self.sheet.torque_noise, self.sheet.sprocket_speed_noise
        measured_torques = soil_torques + noise[0] * self.rng.standard_normal(soil_torques.shape)
        speeds = belts / RADIUS + noise[1] * self.rng.standard_normal(soil_torques.shape)
        out = []
        for k in range(len(soil_torques)):
            at = max(k - delay, 0)
            count = soil_torques.shape[1]
            channels = {
                f"torque_{side}": measured_torques[at, :, s] for s, side in enumerate(SIDES)
            }
            for s, side in enumerate(SIDES):
                channels[f"sprocket_speed_{side}"] = speeds[at, :, s]
            new = (k == 0 or k > delay) if fresh is None else fresh[k]
            measured = make_measurement(
                new,
                PERIOD * (k - at),
                v_x=np.full(count, v_x),
                yaw_rate=np.zeros(count),
                **channels,
            )
            before = actions[k - 1] if k > 0 else np.zeros((count, 2))
            added = {f"previous_action_{side}": before[:, s] for s, side in enumerate(SIDES)}
            added = {name: np.asarray(values, dtype=np.float64) for name, values in added.items()}
            out.append(self.estimator.update(measured.with_fields(added)))
        return out


def error(estimate, gains, lag):
    """Relative errors (N, 3): lag, then gains."""
    true = np.column_stack([np.broadcast_to(lag, len(estimate.value)), *np.transpose(gains)])
    return estimate.value / true - 1.0


@pytest.mark.parametrize("lag", [0.02, 0.05, 0.3])
@pytest.mark.parametrize("gains", [(1.0, 1.0), (0.4, 1.1), (0.7, 0.5)])
def test_exact_torques_give_gains_and_lag_in_a_few_samples(gains, lag):
    actions = commands(100)
    estimates = Bench().run(actions, torques(actions, np.array(gains), lag))
    assert np.abs(error(estimates[20], [gains], lag)).max() < 0.05
    assert np.abs(error(estimates[-1], [gains], lag)).max() < 2e-3
    assert estimates[-1].status[0] == Status.CONVERGING
    assert estimates[-1].excitation[0] > 100.0


def test_the_first_torque_that_follows_a_command_already_shows_a_slow_drive():
    actions = np.full((10, 1, 2), 0.5, dtype=np.float32)
    lags = [e.value[0, 0] for e in Bench().run(actions, torques(actions, 1.0, 0.2))]
    assert lags[0] == pytest.approx(NOMINAL.drive_time_constant)  # nothing has been commanded
    assert lags[1] > 2.0 * NOMINAL.drive_time_constant


def test_the_claimed_deviations_are_those_of_the_errors():
    count, steps = 64, 400
    rng = np.random.default_rng(2)
    gains, lag = rng.uniform(0.4, 1.1, (count, 2)), rng.uniform(0.04, 0.2, count)
    actions = commands(steps, count)
    bench = Bench(count, DataSheet())
    late = bench.run(actions, torques(actions, gains[None], lag))[10::10]
    true = np.column_stack([lag, gains])
    names = bench.estimator.names
    z = np.array(
        [[(e.of(n) - true[:, j]) / e.deviation(n) for j, n in enumerate(names)] for e in late]
    )
    nees = (z**2).mean(axis=(0, 2))
    assert (nees > 0.15).all() and (nees < 1.6).all()
    assert (np.abs(z) < 3.0).mean() > 0.99
    nis = np.array([e.nis for e in late[5:]])
    assert 0.6 < nis.mean() / 2.0 < 1.2


def test_a_gain_that_steps_is_found_within_eight_samples_and_the_rest_stays():
    actions, step = commands(200), 100
    gain = np.ones((200, 1, 2))
    gain[step:, :, 0] = 0.5
    estimates = Bench(sheet=DataSheet()).run(actions, torques(actions, gain, 0.05))
    before, after = estimates[step], estimates[step + 8]
    assert before.of("actuator_gain_left")[0] == pytest.approx(1.0, abs=0.02)
    assert after.of("actuator_gain_left")[0] == pytest.approx(0.5, abs=0.06)
    assert estimates[-1].of("actuator_gain_left")[0] == pytest.approx(0.5, abs=0.01)
    for estimate in estimates[step:]:
        assert estimate.of("actuator_gain_right")[0] == pytest.approx(1.0, abs=0.03)
        assert estimate.of("drive_time_constant")[0] == pytest.approx(0.05, abs=0.01)


def test_torques_that_the_soil_limits_say_nothing_of_the_drives():
    actions = commands(300)
    drive_torques = torques(actions, 1.0, 0.05)
    soil_torques, belts = drive_torques.copy(), np.ones_like(drive_torques)
    limited = np.zeros(len(drive_torques), dtype=bool)
    limited[100:200] = True
    soil_torques[limited], belts[limited] = 0.4 * drive_torques[limited], 4.0  # spinning over 1 m/s
    estimates = Bench(sheet=DataSheet()).run(actions, soil_torques, belts)
    for k in range(102, 200):
        np.testing.assert_array_equal(estimates[k].value, estimates[102].value)
        assert estimates[k].status[0] == Status.HOLDING
    for estimate in estimates[60:]:
        assert np.abs(error(estimate, [(1.0, 1.0)], 0.05)[0, 1:]).max() < 0.02
    belts[limited] = 0.0  # locked
    locked = Bench(sheet=DataSheet()).run(actions, soil_torques, belts)
    assert np.abs(error(locked[199], [(1.0, 1.0)], 0.05)[0, 1:]).max() < 0.02


def test_slow_tracks_and_drives_near_their_top_speed_say_nothing():
    actions = commands(60)
    drive_torques = torques(actions, 0.5, 0.05)
    top = NOMINAL.sprocket_speed_limit * RADIUS
    for belts, v_x in ((0.05, 0.0), (0.05, 0.05), (0.95 * top, 0.95 * top)):
        estimate = Bench().run(actions, drive_torques, belts, v_x)[-1]
        np.testing.assert_allclose(estimate.value, [[0.05, 1.0, 1.0]], rtol=1e-12)
        assert estimate.excitation[0] == pytest.approx(0.0, abs=1e-9)


def test_without_commands_the_prior_stays():
    still = np.zeros((200, 1, 2), dtype=np.float32)
    first, *_, last = Bench(sheet=DataSheet()).run(still, torques(still, 0.5, 0.05))
    assert np.array_equal(first.value, last.value)
    assert (
        last.deviation("actuator_gain_left") > 0.99 * first.deviation("actuator_gain_left")
    ).all()


def test_late_samples_tell_what_fresh_ones_told_then():
    actions = commands(150)
    drive_torques = torques(actions, np.array([0.6, 0.9]), 0.1)
    fresh = Bench().run(actions, drive_torques)
    late = Bench().run(actions, drive_torques, delay=5)
    np.testing.assert_allclose(late[-1].value, fresh[-6].value, rtol=1e-9)


def test_samples_that_come_seldom_or_not_at_all_are_done_without():
    actions = commands(600)
    gains = np.array([0.6, 0.9])
    drive_torques = torques(actions, gains, 0.1)
    every = np.arange(601) % 5 == 0
    seldom = Bench(sheet=DataSheet()).run(actions, drive_torques, fresh=every)
    assert np.abs(error(seldom[-1], [gains], 0.1)).max() < 0.05
    some = np.random.default_rng(3).random(601) > 0.3
    dropped = Bench(sheet=DataSheet()).run(
        actions, np.where(some[:, None, None], drive_torques, 0.0), fresh=some
    )
    assert np.abs(error(dropped[-1], [gains], 0.1)).max() < 0.05
    spoilt = drive_torques.copy()
    spoilt[50:60] = np.nan
    missing = Bench(sheet=DataSheet()).run(actions, spoilt)
    assert np.abs(error(missing[-1], [gains], 0.1)).max() < 0.03
    assert missing[-1].skipped[0] == 20


def test_single_outliers_move_nothing():
    actions = commands(400)
    drive_torques = torques(actions, 1.0, 0.05)
    wild = drive_torques.copy()
    wild[50::40] = 3.0 * LIMIT
    estimates = Bench(sheet=DataSheet()).run(actions, wild)
    assert np.abs([error(e, [(1.0, 1.0)], 0.05)[0] for e in estimates[60:]]).max() < 0.04


def test_the_inertia_of_the_belts_is_told_from_a_weak_drive():
    actions = commands(400)
    drive_torques = torques(actions, np.array([0.6, 1.0]), 0.05)
    time = PERIOD * np.arange(401)
    belts = 1.5 + 0.5 * np.sin(3.0 * time)
    rate = 1.5 * np.cos(3.0 * time) / RADIUS
    for inertia in (0.0, NOMINAL.sprocket_inertia):
        bench = Bench(sheet=DataSheet())
        soil_torques = drive_torques - inertia * rate[:, None, None]
        estimate = bench.run(actions, soil_torques, belts[:, None, None], v_x=1.5)[-1]
        assert np.abs(error(estimate, [(0.6, 1.0)], 0.05)).max() < 0.03
        assert bench.estimator.rows["inertia"][0] == pytest.approx(inertia, abs=1.5)
