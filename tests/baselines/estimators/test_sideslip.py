"""The mass from the steady side slip: the equation, and when it is used."""

import numpy as np
import pytest
from scipy.stats import norm

from baselines.estimators import interacting_models as im
from baselines.estimators import sideslip
from baselines.estimators.measurement import COLUMN, Setting
from tests.baselines.estimators.motion_cases import (
    CLAY,
    RTK,
    TRUTH,
    longitudinal,
    measurements,
    turning,
)
from tracked_env.physics import terramechanics as soil


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
