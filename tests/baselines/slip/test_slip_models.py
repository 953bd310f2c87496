"""Slip models in the loop: accuracy against the plant, edges, symmetry, files."""

import numpy as np
import pytest

from baselines.slip import (
    ExponentialSlipModel,
    NoSlip,
    SlipFamily,
    TableSlipModel,
    TreeSlipModel,
    identified_slip,
    identified_slope_slip,
    load,
    slip_family,
    with_friction,
)
from baselines.slip.slip_models import Grid
from baselines.slip.slip_regression import grow, split
from baselines.slip.slip_sweep import slip_data, slope_sweep, steady_motion, sweep, upsample
from baselines.slip.slope_motion import steady_on_slopes
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
SLIPPERY = with_friction(FOCCHI, 0.1)
EXPONENTIAL = ExponentialSlipModel([[0.2, 2.0], [-0.2, 2.0], [0.5, 3.0]], FOCCHI.track_gauge)


@pytest.fixture(scope="module")
def grown():
    dense, _grid = upsample(sweep(SLIPPERY), SLIPPERY, spacing=0.25)
    training, test = split(dense)
    trees = grow(training)
    return trees, TreeSlipModel(trees, SLIPPERY.sprocket_radius), test


@pytest.fixture(scope="module", params=["table", "tree", "exponential"])
def model(request, grown):
    models = {"table": identified_slip(SLIPPERY), "tree": grown[1], "exponential": EXPONENTIAL}
    return models[request.param]


def random_speeds(count, seed=0, reach=10.0):
    return np.random.default_rng(seed).uniform(-reach, reach, (2, count))


@pytest.mark.parametrize("mu", [0.1, 0.4, 0.8])
def test_the_table_is_as_near_to_the_plant_as_promised(mu):
    parameters = with_friction(FOCCHI, mu)
    left, right = random_speeds(300, seed=4)
    truth = slip_data(parameters, left, right, steady_motion(parameters, left, right))
    beta_left, beta_right, alpha = identified_slip(parameters).slip(left, right)
    for error in (beta_left - truth.beta_left, beta_right - truth.beta_right):
        assert np.sqrt(np.mean(error**2)) < 1e-3  # m/s
        assert np.abs(error).max() < 8e-3
    driving = np.abs(truth.v_x) > 0.05
    assert np.abs(alpha - truth.alpha)[driving].max() < 0.02


def test_trees_predict_what_scikit_learn_predicts_bit_for_bit(grown):
    trees, model, test = grown
    tree = trees[0].tree_
    edges = tree.threshold[tree.feature == 0] + 1e-9  # above a threshold in double precision
    speeds = random_speeds(5000, seed=5, reach=12.0), [edges, np.full(len(edges), 3.3)]
    left, right = np.hstack([*speeds, [test.sprocket_left, test.sprocket_right]])
    beta_left, beta_right, alpha = model.slip(left, right)
    expected = [each.predict(np.stack([left, right], axis=1)) for each in trees]
    np.testing.assert_array_equal([beta_left, beta_right], expected[:2])
    forward = SLIPPERY.sprocket_radius * (left + right) - (beta_left + beta_right) >= 0.0
    moving = (left != 0.0) | (right != 0.0)
    np.testing.assert_array_equal(alpha[moving], np.where(forward, *expected[2:])[moving])


def test_slip_is_exactly_zero_at_standstill_and_of_a_unicycle(model):
    np.testing.assert_array_equal(model.slip(np.zeros(3), np.zeros(3)), np.zeros((3, 3)))
    np.testing.assert_array_equal(NoSlip().slip(np.ones(3), np.ones(3)), np.zeros((3, 3)))


def test_the_table_is_continuous_and_slip_outside_is_that_of_its_edge():
    table = identified_slip(SLIPPERY)
    left = np.linspace(-9.9, 9.9, 400_001)  # the vehicle changes its direction
    for column in table.slip(left, np.full(len(left), 6.0)):
        assert np.abs(np.diff(column)).max() < 2e-3
    far = table.slip(np.array([30.0, -50.0]), np.array([4.0, 99.0]))
    edge = table.slip(np.array([10.0, -10.0]), np.array([4.0, 10.0]))
    np.testing.assert_array_equal(far[:2], edge[:2])
    assert np.isfinite(far[2]).all()


@pytest.mark.parametrize("model", [identified_slip(SLIPPERY), EXPONENTIAL])
def test_slip_mirrors_left_to_right_and_front_to_back(model):
    left, right = random_speeds(500, seed=6)
    beta_left, beta_right, alpha = model.slip(left, right)
    mirrored = model.slip(right, left)
    np.testing.assert_allclose(mirrored, [beta_right, beta_left, -alpha], atol=1e-12)
    np.testing.assert_allclose(
        model.slip(-left, -right), [-beta_left, -beta_right, -alpha], atol=1e-12
    )


def test_straight_driving_has_no_alpha_and_a_row_of_a_batch_is_the_single_call(model, grown):
    speed = np.linspace(-9.0, 9.0, 50)
    tolerance = 0.02 if model is grown[1] else 1e-12  # a tree is a staircase
    np.testing.assert_allclose(model.slip(speed, speed)[2], 0.0, atol=tolerance)
    left, right = random_speeds(20, seed=7)
    batch = np.array(model.slip(left, right))
    for i in range(20):
        single = model.slip(left[i : i + 1], right[i : i + 1])
        np.testing.assert_array_equal(single, batch[:, i : i + 1])


def test_a_saved_model_gives_the_same_slip(tmp_path):
    path, model, speeds = tmp_path / "slip.npz", identified_slip(SLIPPERY), random_speeds(200, 8)
    model.save(path)
    assert path.stat().st_size < 1_000_000
    np.testing.assert_allclose(load(path).slip(*speeds), model.slip(*speeds), atol=2e-6)


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
    slip = np.array(family.at(mu).slip(left, right))
    for i in range(6):
        alone = family.slip(left[i : i + 1], right[i : i + 1], mu[i % 3])
        np.testing.assert_array_equal(slip[:, i : i + 1], alone)
    with pytest.raises(ValueError, match="5 sprocket speeds for 1 slopes and 3 frictions"):
        family.at(mu).slip(left[:5], right[:5])


def slopes_of(count):
    model = identified_slope_slip(FOCCHI, speed_step=2.5, slope_step=0.21875)
    return model.on(np.zeros((count, 2)))


GRID = Grid(1.0, 1, 1, 3, 3)
WRONG = {
    "shape": lambda: TableSlipModel.of(np.zeros((3, 4, 3)), GRID, 0.1),
    "not finite": lambda: TableSlipModel.of(np.full((3, 3, 3), np.nan), GRID, 0.1),
    "rising": lambda: SlipFamily(np.zeros((2, 3, 3, 3)), GRID, 0.1, [0.4, 0.1]),
    r"c_2 >= 0 1/m": lambda: ExponentialSlipModel([[0.2, -1.0], [0.2, 1.0], [0.2, 1.0]], 0.6),
    "sprocket speeds have shapes": lambda: EXPONENTIAL.slip(np.zeros((3, 2)), np.zeros((3, 2))),
    r"step = 20\.0 rad/s": lambda: sweep(FOCCHI, step=20.0),
    "mu = 40": lambda: with_friction(FOCCHI, 40.0),
    "unknown load 'even'": lambda: steady_on_slopes(FOCCHI, [[1.0, 1.0]], [[0.0, 0.0]], "even"),
    "slope_step = 5": lambda: slope_sweep(FOCCHI, slope_step=5.0),
    "3 sprocket speeds for 2 slopes": lambda: slopes_of(2).slip(*np.ones((2, 3))),
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_arguments_are_refused_with_quantity_and_cause(message):
    with pytest.raises(ValueError, match=message):
        WRONG[message]()


def test_a_file_that_holds_no_table_is_refused(tmp_path):
    (tmp_path / "no.npz").write_bytes(b"no archive")
    np.savez(tmp_path / "other.npz", kind="other")
    np.savez(tmp_path / "part.npz", kind="table", table=np.zeros((3, 3, 3)))
    np.savez_compressed(tmp_path / "large.npz", table=np.zeros(2**28 + 1, np.uint8))
    causes = {"no": "not an npz", "other": "kind of slip model is other", "part": "grid"}
    for name, cause in (*causes.items(), ("large", "it unpacks to")):
        with pytest.raises(ValueError, match=f"{name}.npz: .*{cause}"):
            load(tmp_path / f"{name}.npz")
