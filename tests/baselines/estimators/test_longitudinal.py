"""Mass and motion resistance from exact measurements, what both regressions do alike, and the mass
from the steady side slip."""

from functools import partial

import numpy as np
import pytest
from scipy.stats import norm

from baselines.estimators import interacting_models as im
from baselines.estimators import longitudinal as sideslip
from baselines.estimators.measurement import COLUMN, DRIVE, INERTIAL, Setting, Status
from tests.baselines.estimators.motion_cases import (
    CLAY,
    KINDS,
    LATERAL_MODELS,
    RTK,
    TRUTH,
    assert_consistent,
    follow,
    longitudinal,
    measurements,
    mirrored,
    true_across,
    true_along,
    turning,
)
from tracked_env.physics import terramechanics as soil


def relative_error(estimate, p):
    """(N, 2) of 1/m and mu_l."""
    return estimate.value / true_along(p) - 1.0


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
@pytest.mark.parametrize("kind", ["straight", "curves", "reverse"])
def test_without_noise_the_coupled_regression_finds_mass_and_resistance(kind, lateral_model):
    samples = measurements(TRUTH._replace(icr_forward=0.2), kind, lateral_model)
    last = follow(longitudinal(), samples)[-1]
    assert np.abs(relative_error(last, TRUTH)).max() < 1e-4  # what is left of the prior
    assert last.status[0] == Status.CONVERGING


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_on_the_spot_the_resistances_cancel_and_the_mass_is_found_alone(lateral_model):
    last = follow(longitudinal(), measurements(TRUTH, "pivot", lateral_model))[-1]
    assert abs(relative_error(last, TRUTH)[0, 0]) < 1e-5
    assert last.of("longitudinal_resistance") == CLAY.longitudinal_resistance
    assert last.deviation("longitudinal_resistance") == pytest.approx(0.3, rel=1e-6)
    assert last.status[0] == Status.HOLDING
    assert last.excitation[0] == 0.0
    assert last.condition[0] > 1e9


@pytest.mark.parametrize("kind", ["straight", "curves", "reverse"])
def test_with_the_noise_of_the_sensors_errors_are_small_and_as_large_as_said(kind):
    count = 200
    results = follow(longitudinal(RTK, count), measurements(TRUTH, kind, sheet=RTK, count=count))
    error = relative_error(results[-1], TRUTH)
    assert np.sqrt((error**2).mean(0)).max() < 0.01
    assert_consistent(results[100::100], true_along(TRUTH), 0.1, 2.2)  # the resistance rests here
    innovations = np.array([result.nis for result in results[20:]])
    assert 0.7 < np.nanmean(innovations) < 1.1


def test_a_long_straight_at_constant_speed_leaves_the_mass_as_it_was():
    count, steps = 20, 15_000
    part = longitudinal(RTK, count)
    first = follow(part, measurements(TRUTH, "curves", sheet=RTK, count=count))[-1]
    steady = measurements(TRUTH, "steady", sheet=RTK, count=count, steps=steps)
    last = follow(part, steady)[-1]
    drift = (last.of("inverse_mass") / first.of("inverse_mass")) - 1.0
    assert np.abs(drift).max() < 0.02
    assert np.abs(relative_error(last, TRUTH)).max() < 0.05
    assert (last.status == Status.HOLDING).all()


@pytest.mark.parametrize(
    ("belts", "v_x"),
    [((0.0, 1.2), 1.0), ((6.0, 1.2), 1.0), ((6.0, 0.0), 1.0), ((-1.4, 1.2), 1.0)],
    ids=["locked", "spinning", "both", "against"],
)
def test_a_belt_that_spins_or_is_locked_says_nothing_on_the_mass(belts, v_x):
    """There the filter can take a track for one that moves the other way."""
    samples = measurements(TRUTH, "straight")
    driving = longitudinal()
    follow(driving, samples[:200])
    before = driving.memory.copy()
    for m in samples[200:250]:
        m.values[:, COLUMN["v_x"]], m.values[:, COLUMN["yaw_rate"]] = v_x, 0.0
        for side, belt in zip(("left", "right"), belts, strict=True):
            m.values[:, COLUMN[f"sprocket_speed_{side}"]] = belt / CLAY.sprocket_radius
            m.values[:, COLUMN[f"torque_{side}"]] = 0.0
        m.values[:, COLUMN["acceleration_x"]] = -1.4
    last = follow(driving, samples[200:250])[-1]
    assert np.array_equal(driving.memory, before)
    assert last.status[0] == Status.HOLDING
    for m in samples[200:250]:
        for side in ("left", "right"):
            m.values[:, COLUMN[f"sprocket_speed_{side}"]] = v_x / CLAY.sprocket_radius
    follow(driving, samples[200:250])
    assert not np.array_equal(driving.memory, before)


def test_excitation_and_condition_are_those_of_the_information():
    part = longitudinal(RTK, 3)
    last = follow(part, measurements(TRUTH, "curves", sheet=RTK, count=3, steps=50))[-1]
    for i in range(3):
        a, b, c = (part.rows["estimates"][name][i, 0] for name in ("j_11", "j_12", "j_22"))
        information = np.array([[a, b], [b, c]])
        assert last.excitation[i] == pytest.approx(np.linalg.eigvalsh(information)[0], rel=1e-7)
        assert last.condition[i] == pytest.approx(np.linalg.cond(information), rel=1e-7)


# --- both regressions

READ_ALONG = ("v_x", "yaw_rate", "acceleration_x", "torque_left", "torque_right")
READ_ACROSS = ("v_x", "yaw_rate", "yaw_acceleration", "acceleration_y")
along, across = partial(longitudinal, RTK), partial(turning, RTK)
BOTH = pytest.mark.parametrize("make", [along, across], ids=["longitudinal", "turning"])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("make", "options"),
    [(along, {}), (across, {"lateral": "sliding"}), (across, {"lateral": "constrained"})],
)
def test_exchanging_left_and_right_changes_nothing(make, options, kind):
    lateral_model = options.get("lateral", "sliding")
    samples = measurements(TRUTH, kind, lateral_model, sheet=RTK, steps=300)
    one, other = make(**options), make(**options)
    follow(one, samples)
    follow(other, [mirrored(sample) for sample in samples])
    if make is across:
        one.rows["trend"] *= -1.0  # the innovation changes its sign
    assert np.array_equal(one.memory, other.memory)


@pytest.mark.parametrize(
    ("make", "yaw_rate"),
    [(along, 0.0), (across, 0.1)],  # the tracks are slower than the soil lets go
)
def test_at_standstill_and_with_old_samples_everything_is_kept(make, yaw_rate):
    part = make()
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=300)
    before = follow(part, samples)[-1]
    memory = part.memory.copy()
    still = samples[0]._replace(values=samples[0].values.copy())
    still.values[:, COLUMN["v_x"]] = 0.0
    still.values[:, COLUMN["yaw_rate"]] = yaw_rate
    for _ in range(5000):
        after = part.update(still)
        assert after.status[0] == Status.HOLDING
    for group in (INERTIAL, DRIVE):
        old = samples[0].fresh.copy()
        old[:, group] = False
        assert part.update(samples[0]._replace(fresh=old)).status[0] == Status.HOLDING
    assert np.array_equal(part.memory, memory)
    assert np.array_equal(part.read().value, before.value)
    assert np.isnan(after.nis[0])


@pytest.mark.parametrize(
    ("make", "channel"), [*((along, n) for n in READ_ALONG), *((across, n) for n in READ_ACROSS)]
)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_missing_number_is_skipped_and_counted(make, channel, value):
    part = make()
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=200)
    before = follow(part, samples)[-1]
    samples[0].values[:, COLUMN[channel]] = value
    after = part.update(samples[0])
    assert after.status[0] == Status.REJECTED
    assert after.skipped[0] == before.skipped[0] + 1 == 1
    assert np.array_equal(after.value, before.value)
    assert np.array_equal(after.covariance, before.covariance)


@BOTH
def test_a_torque_that_no_drive_has_is_refused(make):
    part = make()
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=50)
    follow(part, samples)
    memory = part.memory.copy()
    for channel in ("torque_left", "torque_right"):
        wild = samples[0]._replace(values=samples[0].values.copy())
        wild.values[:, COLUMN[channel]] = -2.0 * CLAY.torque_limit
        assert part.update(wild).status[0] == Status.REJECTED
    assert np.array_equal(part.memory, memory)


@pytest.mark.parametrize(
    ("make", "true", "change", "largest"),
    [
        (along, true_along, {"mass": 1.35 * TRUTH.mass}, 0.02),
        (along, true_along, {"longitudinal_resistance": 0.8}, 0.02),
        (across, true_across, {"lateral_resistance": 0.4}, 0.05),
    ],
)
def test_a_change_is_put_down_to_the_parameter_that_changes(make, true, change, largest):
    count, other = 50, TRUTH._replace(**change)
    before = measurements(TRUTH, "curves", sheet=RTK, count=count, steps=600)
    after = measurements(other, "curves", sheet=RTK, count=count, steps=600, seed=1)
    error = np.abs(follow(make(count=count), before + after)[-1].value / true(other) - 1.0)
    assert np.quantile(error, 0.9, axis=0).max() < largest


@pytest.mark.parametrize(
    ("make", "lateral_model", "low", "high", "scale"),
    [
        (along, "sliding", [0.2 / CLAY.mass, 0.0], [5.0 / CLAY.mass, 1.5], [1e3, 1.0]),
        *(
            (across, model, [CLAY.inertia / 6.0, 0.0], [6.0 * CLAY.inertia, 2.0], [1e-3, 1.0])
            for model in LATERAL_MODELS
        ),
    ],
)
def test_bounds_hold_under_dropouts_outliers_and_reversals(make, lateral_model, low, high, scale):
    rng = np.random.default_rng(6)
    rounding = (1e-12 if make is along else 0.0) * np.array(high)
    part, samples = make(count=20, lateral=lateral_model), []
    for seed, kind in enumerate(("curves", "reverse", "pivot", "straight", "curves")):
        samples += measurements(TRUTH, kind, lateral_model, RTK, count=20, seed=seed, steps=300)
    for sample in samples:
        wild = rng.random(sample.values.shape) < 0.01
        sample.values[wild] *= rng.choice([-50.0, 0.0, 50.0, np.nan], wild.sum())
        estimate = part.update(sample)
        assert (estimate.value >= low - rounding).all()
        assert (estimate.value <= high + rounding).all()
        assert (np.linalg.eigvalsh(estimate.covariance * np.outer(scale, scale)) > 0.0).all()
    if make is along:
        error = np.abs(estimate.value[:, 0] / true_along(TRUTH)[0] - 1.0)
        assert np.quantile(error, 0.9) < 0.1


def turning_vehicle(memory, share=0.0):
    """Row, both regressions that know the vehicle, and a sample of a turn; memory: of the row,
    share: slip share [-] of the belts' yaw rate."""
    row = sideslip.SideslipRow(Setting(CLAY, 0.02, RTK, 1))
    row.memory[:] = memory
    along, across = longitudinal(RTK), turning(RTK)
    for sample in measurements(TRUTH, "curves", sheet=RTK, steps=500):
        along.update(sample)
        across.update(sample)
    across.rows["turned"], across.rows["belts"] = 1.0 - share, 1.0
    turn = next(
        s
        for s in measurements(TRUTH, "curves", steps=500)
        if abs(s.channel("yaw_rate")[0]) > 0.4 and abs(s.channel("v_y")[0]) > 0.02
    )
    return row, along, across, turn


def test_the_expected_side_slip_is_that_of_the_lateral_friction():
    row, *_ = turning_vehicle([0.0, 0.0])
    z = np.zeros((1, 13))
    for w in (-0.6, 0.15, 0.5):
        for v_y in (-0.05, 0.03):
            intensity = TRUTH.lateral_resistance * soil.GRAVITY / CLAY.contact_length
            a_y, _moment = soil.lateral_friction(v_y, w, intensity, CLAY.contact_length)
            z[0, [COLUMN["v_y"], COLUMN["acceleration_y"], COLUMN["yaw_rate"]]] = v_y, a_y, w
            friction = TRUTH.mass * TRUTH.lateral_resistance
            v_y_expected, variance = sideslip.expected(
                z, 0, row._constants, 1.0 / TRUTH.mass, friction, 1.0, 1.0
            )
            assert v_y_expected == pytest.approx(v_y, rel=0.02)
            assert variance > RTK.velocity_noise**2


@pytest.mark.parametrize(
    ("memory", "share", "used"),
    [
        ([0.0, 0.0], 0.25, False),
        ([1.0, 1.0], 0.25, False),
        ([12.0, 9.0], 0.25, False),
        ([100.0, 100.0], 0.25, True),
        ([100.0, 57.0], 0.25, False),
        ([0.0, 0.0], 0.01, True),
        ([0.0, 0.0], -0.5, False),
    ],
    ids=["nothing known", "unproven", "another plant, at first", "proven", "of another plant",
         "firm soil", "belts slower than the vehicle"],
)  # fmt: skip
def test_it_is_used_on_firm_soil_and_where_it_has_been_found_to_hold(memory, share, used):
    row, along, across, turn = turning_vehicle(memory, share)
    before, deviation = along.memory.copy(), along.read().deviation("inverse_mass")
    row.compute(turn, along, across)
    assert np.array_equal(before, along.memory) != used
    assert (along.read().deviation("inverse_mass") < deviation) == used


def test_without_a_turn_nothing_says_that_the_soil_is_firm():
    row, along, across, turn = turning_vehicle([0.0, 0.0])
    across.rows["turned"] = across.rows["belts"] = 0.0
    before = along.memory.copy()
    row.compute(turn, along, across)
    assert np.array_equal(before, along.memory)


def test_the_agreement_is_the_likelihood_of_a_ratio_of_one_over_that_of_any_other():
    for square, ratio in ((100.0, 1.0), (100.0, 0.57), (4.0, 0.9)):
        row, along, across, turn = turning_vehicle([square, ratio * square], 0.25)
        row._constants = row._constants._replace(keep=1.0)
        along.rows["alarm"] = 1.0  # no calm time: the sums stay
        row.compute(turn, along, across)
        expected = norm.pdf(ratio, 1.0, 1.0 / np.sqrt(square))
        assert across.rows["agreement"][0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("deviations", "share", "alarmed"),
    [(4.5, 0.01, True), (3.5, 0.01, False), (4.5, 0.25, False)],
    ids=["evident", "not evident", "evident, but shared friction"],
)
def test_an_evident_trend_of_the_friction_is_an_alarm_of_the_mass_where_it_holds(
    deviations, share, alarmed
):
    row, along, across, turn = turning_vehicle([0.0, 0.0], share)
    averaged = 0.02 / im.TREND_TIME
    across.rows["trend"] = deviations * np.sqrt(averaged / (2.0 - averaged))
    across.rows["alarm"] = 2.5
    row.compute(turn, along, across)
    assert along.rows["alarm"][0] == (2.5 if alarmed else 0.0)


@pytest.mark.parametrize("channel", ["v_y", "acceleration_y", "yaw_rate", "v_x", "pose_age"])
def test_a_missing_number_or_an_older_velocity_leaves_everything_as_it_was(channel):
    row, along, across, turn = turning_vehicle([100.0, 100.0])
    if channel == "pose_age":
        turn.age[:, 0] = 0.2
    else:
        turn.values[:, COLUMN[channel]] = np.nan
    before = along.memory.copy()
    row.compute(turn, along, across)
    assert np.array_equal(before, along.memory)
    assert np.array_equal(row.memory, [[100.0, 100.0]])
