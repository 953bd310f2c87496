"""Slip models in the loop: accuracy against the plant, edges, symmetry, files, speed."""

import time

import numpy as np
import pytest

from baselines.slip import slip_models
from baselines.slip.slip_models import (
    ExponentialSlipModel,
    Grid,
    NoSlip,
    SlipFamily,
    TableSlipModel,
)
from baselines.slip.slip_regression import as_arrays, grow, split
from baselines.slip.slip_sweep import (
    identified_slip,
    slip_data,
    slip_family,
    steady_motion,
    sweep,
    upsample,
    with_friction,
)
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
SLIPPERY = with_friction(FOCCHI, 0.1)
EXPONENTIAL = ExponentialSlipModel([[0.2, 2.0], [-0.2, 2.0], [0.5, 3.0]], FOCCHI.track_gauge)


@pytest.fixture(scope="module")
def grown():
    dense, _grid = upsample(sweep(SLIPPERY), SLIPPERY, spacing=0.25)
    training, test = split(dense)
    trees = grow(training)
    return trees, slip_models.TreeSlipModel(as_arrays(trees), SLIPPERY.sprocket_radius), test


@pytest.fixture(scope="module", params=["table", "tree", "exponential"])
def model(request, grown):
    return {"table": identified_slip(SLIPPERY), "tree": grown[1], "exponential": EXPONENTIAL}[
        request.param
    ]


def random_speeds(count, seed=0, reach=10.0):
    return np.random.default_rng(seed).uniform(-reach, reach, (2, count))


@pytest.mark.parametrize("mu", [0.1, 0.4, 0.8])
def test_the_table_is_as_near_to_the_plant_as_promised(mu):
    parameters = with_friction(FOCCHI, mu)
    left, right = random_speeds(300, seed=4)
    truth = slip_data(parameters, left, right, steady_motion(parameters, left, right))
    beta_left, beta_right, alpha = identified_slip(parameters).slip(left, right)
    for found, true in ((beta_left, truth.beta_left), (beta_right, truth.beta_right)):
        assert np.sqrt(np.mean((found - true) ** 2)) < 1e-3  # m/s
        assert np.abs(found - true).max() < 8e-3
    driving = np.abs(truth.v_x) > 0.05
    assert np.abs(alpha - truth.alpha)[driving].max() < 0.02


def test_tree_arrays_predict_what_scikit_learn_predicts_bit_for_bit(grown):
    trees, model, test = grown
    left, right = random_speeds(5000, seed=5, reach=12.0)
    left, right = np.append(left, test.sprocket_left), np.append(right, test.sprocket_right)
    edges = model.trees[2][model.trees[1] == 0] + 1e-9  # above a threshold in double precision
    left, right = np.append(left, edges), np.append(right, np.full(len(edges), 3.3))
    found = model.slip(left, right)
    inputs = np.stack([left, right], axis=1)
    expected = [tree.predict(inputs) for tree in trees]
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])
    radius = SLIPPERY.sprocket_radius
    forward = radius * (left + right) - (found[0] + found[1]) >= 0.0
    still = (left == 0.0) & (right == 0.0)
    alpha = np.where(forward, expected[2], expected[3])
    np.testing.assert_array_equal(found[2][~still], alpha[~still])


def test_slip_is_exactly_zero_at_standstill(model):
    for column in model.slip(np.zeros(3), np.zeros(3)):
        np.testing.assert_array_equal(column, 0.0)


def test_the_slip_of_a_unicycle_is_none():
    for column in NoSlip().slip(np.ones(3), np.ones(3)):
        np.testing.assert_array_equal(column, np.zeros(3))


def test_outside_the_table_slip_is_that_of_its_edge():
    table = identified_slip(SLIPPERY)
    far = table.slip(np.array([30.0, -50.0]), np.array([4.0, 99.0]))
    edge = table.slip(np.array([10.0, -10.0]), np.array([4.0, 10.0]))
    np.testing.assert_array_equal(far[0], edge[0])
    np.testing.assert_array_equal(far[1], edge[1])
    assert np.isfinite(far[2]).all()


def test_the_table_is_continuous_also_where_the_vehicle_changes_direction():
    table = identified_slip(SLIPPERY)
    left = np.linspace(-9.9, 9.9, 400_001)
    for column in table.slip(left, np.full(len(left), 6.0)):
        assert np.abs(np.diff(column)).max() < 2e-3


@pytest.mark.parametrize("model", [identified_slip(SLIPPERY), EXPONENTIAL])
def test_slip_mirrors_left_to_right_and_front_to_back(model):
    left, right = random_speeds(500, seed=6)
    beta_left, beta_right, alpha = model.slip(left, right)
    mirrored = model.slip(right, left)
    np.testing.assert_allclose(mirrored, [beta_right, beta_left, -alpha], atol=1e-12)
    np.testing.assert_allclose(
        model.slip(-left, -right), [-beta_left, -beta_right, -alpha], atol=1e-12
    )


def test_straight_driving_has_no_alpha(model, grown):
    speed = np.linspace(-9.0, 9.0, 50)
    _left, _right, alpha = model.slip(speed, speed)
    tolerance = 0.02 if model is grown[1] else 1e-12  # a tree is a staircase
    np.testing.assert_allclose(alpha, 0.0, atol=tolerance)


def test_a_row_of_a_batch_is_the_single_call(model):
    left, right = random_speeds(20, seed=7)
    batch = np.array(model.slip(left, right))
    for i in range(20):
        single = np.array(model.slip(left[i : i + 1], right[i : i + 1]))
        np.testing.assert_array_equal(single[:, 0], batch[:, i])


def test_a_saved_model_gives_the_same_slip(model, tmp_path):
    path = tmp_path / "slip.npz"
    model.save(path)
    assert path.stat().st_size < 1_000_000
    left, right = random_speeds(200, seed=8)
    again = slip_models.load(path)
    assert type(again) is type(model)
    np.testing.assert_allclose(again.slip(left, right), model.slip(left, right), atol=2e-6)


def test_a_lookup_takes_less_than_a_microsecond():
    table = identified_slip(SLIPPERY)
    left, right = random_speeds(100_000)
    table.slip(left, right)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        table.slip(left, right)
        times.append(time.perf_counter() - start)
    assert min(times) / len(left) < 1e-6


def test_the_same_vehicle_is_swept_once():
    assert identified_slip(SLIPPERY) is identified_slip(with_friction(FOCCHI, 0.1))
    assert slip_family(FOCCHI) is slip_family(FOCCHI)


def test_a_family_is_its_tables_at_their_frictions_and_clamped_beyond():
    family = slip_family(FOCCHI)
    left, right = random_speeds(50, seed=9)
    for mu in family.frictions[[0, 3, -1]]:
        table = identified_slip(with_friction(FOCCHI, float(mu)))
        np.testing.assert_allclose(family.slip(left, right, mu), table.slip(left, right), atol=1e-9)
    np.testing.assert_array_equal(family.slip(left, right, 9.0), family.slip(left, right, mu))


def test_each_vehicle_of_a_family_is_on_its_own_friction_also_when_asked_several_times():
    family = slip_family(FOCCHI)
    mu = np.array([0.1, 0.3, 0.7])
    left, right = random_speeds(6, seed=10)
    found = np.array(family.at(mu).slip(left, right))
    for i in range(6):
        alone = family.slip(left[i : i + 1], right[i : i + 1], mu[i % 3])
        np.testing.assert_array_equal(found[:, i], np.array(alone)[:, 0])
    with pytest.raises(ValueError, match="5 sprocket speeds for 1 slopes and 3 frictions"):
        family.at(mu).slip(left[:5], right[:5])


def test_bad_tables_and_speeds_are_refused_with_quantity_and_cause(tmp_path):
    grid = Grid(1.0, 1, 1, 3, 3)
    with pytest.raises(ValueError, match="shape"):
        TableSlipModel.of(np.zeros((3, 4, 3)), grid, 0.1)
    with pytest.raises(ValueError, match="not finite"):
        TableSlipModel.of(np.full((3, 3, 3), np.nan), grid, 0.1)
    with pytest.raises(ValueError, match="rising"):
        SlipFamily(np.zeros((2, 3, 3, 3)), grid, 0.1, [0.4, 0.1])
    with pytest.raises(ValueError, match="c_2 = -1"):
        ExponentialSlipModel([[0.2, -1.0], [0.2, 1.0], [0.2, 1.0]], 0.6)
    with pytest.raises(ValueError, match="sprocket speeds have shapes"):
        identified_slip(SLIPPERY).slip(np.zeros((3, 2)), np.zeros((3, 2)))
    np.savez(tmp_path / "other.npz", kind="other")
    with pytest.raises(ValueError, match="kind of slip model is other"):
        slip_models.load(tmp_path / "other.npz")
    (tmp_path / "no.npz").write_bytes(b"no archive")
    np.savez(tmp_path / "part.npz", kind="table", table=np.zeros((3, 3, 3)))
    np.savez_compressed(tmp_path / "large.npz", table=np.zeros(2**28 + 1, np.uint8))
    for name, says in (("no", "not an npz"), ("part", "grid"), ("large", "it unpacks to")):
        with pytest.raises(ValueError, match=f"{name}.npz: .*{says}"):
            slip_models.load(tmp_path / f"{name}.npz")
