"""What estimators declare makes the features; an estimator is added by one registration."""

import numpy as np
import pytest

from baselines.estimators import stack as stacks
from baselines.estimators.measurement import DRIVE, Estimate, Quantity, Status
from baselines.estimators.stack import ESTIMATORS, FEATURES, QUANTITIES, IdentificationStack
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from tracked_env import observation as layout
from tracked_env import sensors
from tracked_env.physics import lumped
from tracked_env.physics.parameters import RANGES, VEHICLES
from tracked_env.sensors import CHANNELS, Channel
from tracked_env.vector_env import TrackedVehicleVectorEnv
from tracked_env.wrappers import IdentifiedVectorObservation

NOMINAL = VEHICLES["strawa"]
COUNT = 4
START = np.ones(COUNT, dtype=bool)


@pytest.fixture(scope="module")
def drive():
    """Observations of a controlled drive with late poses, (steps, N, SIZE)."""
    env = TrackedVehicleVectorEnv(
        COUNT, uncertainty="mixed", sensors={"preset": "rtk", "pose_delay": 0.1}
    )
    observation, state, seen = env.reset(seed=0)[0], None, []
    controller = FeedbackLinearizingController(NOMINAL)
    for _ in range(150):
        seen.append(observation)
        action, state = controller.predict(observation, state)
        observation = env.step(action)[0]
    return np.array(seen)


def written_out(known):
    """The features as formulas: what agents were trained with, for good."""
    p, maximum = NOMINAL, lumped.drive_limits(NOMINAL).effort_maximum
    a, t, s, g = known.longitudinal, known.turning, known.slip, known.soil
    mass = 1.0 / a.value[:, 0]
    sigma = {
        e: np.sqrt(np.diagonal(of.covariance, axis1=1, axis2=2))
        for e, of in (("a", a), ("t", t), ("s", s), ("g", g))
    }
    values = [
        mass / p.mass, a.value[:, 1], t.value[:, 0] / p.inertia, t.value[:, 1],
        s.value[:, 3], s.value[:, 4], s.value[:, 5], np.log(g.value[:, 0] / maximum),
        np.log(g.value[:, 1] / p.shear_deformation_modulus),
    ]  # fmt: skip
    deviations = [
        sigma["a"][:, 0] * mass**2 / p.mass, sigma["a"][:, 1], sigma["t"][:, 0] / p.inertia,
        sigma["t"][:, 1], sigma["s"][:, 3], sigma["s"][:, 4], sigma["s"][:, 5],
        *np.log1p(sigma["g"] / g.value).T,
    ]  # fmt: skip
    excitations = [e.excitation / (1.0 + e.excitation) for e in (a, t, s, g)]
    return np.stack([*values, *deviations, *excitations], axis=-1).astype(np.float32)


def test_the_features_are_bit_for_bit_what_agents_were_trained_with(drive):
    assert QUANTITIES == (
        "mass", "longitudinal_resistance", "inertia", "lateral_resistance", "slip_left",
        "slip_right", "side_slip", "effort_maximum", "shear_deformation_modulus",
    )  # fmt: skip
    assert ESTIMATORS == ("longitudinal", "turning", "slip", "soil")
    assert (
        *QUANTITIES,
        *(f"{name}_deviation" for name in QUANTITIES),
        *(f"{name}_excitation" for name in ESTIMATORS),
    ) == FEATURES
    stack, twin = IdentificationStack(count=COUNT), IdentificationStack(count=COUNT)
    for k, observation in enumerate(drive):
        shown = stack.observe(observation, START & (k == 0))
        assert np.array_equal(shown, written_out(twin.update(observation, START & (k == 0))))


class Simple:
    """What the estimators of these tests share: state, and an Estimate of one quantity."""

    columns = 1

    def __init__(self, setting):
        self.radius = setting.parameters.sprocket_radius
        self.memory = np.zeros((setting.count, self.columns))

    def take_over(self, parts, estimates):
        """Nothing is needed of other estimators."""

    def estimate(self, value, variance, status):
        n = len(value)
        return Estimate(
            (self.provides[0].name,), value[:, None], variance[:, None, None], 1.0 / variance,
            np.ones(n), status, np.full(n, np.nan), np.zeros(n, dtype=np.int64),
        )  # fmt: skip

    def reset(self, rows=None):
        self.memory[slice(None) if rows is None else rows] = 0.0


class BeltAdvance(Simple):
    """Mean of v_belt / v_x - 1 while driving, and its deviation: an estimator of a few lines."""

    provides = (Quantity("belt_advance", "-"),)
    needs = ("v_x", "sprocket_speed_left", "mass")
    paired = True
    columns = 2  # samples, their sum

    def take_over(self, parts, estimates):
        self.mass = 1.0 / estimates["longitudinal"].of("inverse_mass")

    def update(self, measurement):
        v_x, omega = measurement.channel("v_x"), measurement.channel("sprocket_speed_left")
        driving = np.isfinite(omega) & (np.abs(v_x) > 0.5)
        advance = self.radius * omega / np.where(driving, v_x, 1.0) - 1.0
        self.memory += driving[:, None] * np.stack([np.ones_like(v_x), advance], axis=1)
        count = np.maximum(self.memory[:, 0], 1.0)
        status = np.where(driving, Status.CONVERGING, Status.HOLDING)
        return self.estimate(self.memory[:, 1] / count, 1.0 / count, status)


def test_a_registered_estimator_adds_its_features_behind_and_changes_nothing_else(
    drive, registries
):
    stacks.register("belts", BeltAdvance)
    plain, more = (
        IdentificationStack(count=COUNT),
        IdentificationStack(count=COUNT, further=["belts"]),
    )
    own = ("belt_advance", "belt_advance_deviation", "belts_excitation")
    assert more.feature_names == (*FEATURES, *own)
    for k, observation in enumerate(drive):
        start = START & (k == 0)
        before, after = plain.observe(observation, start), more.observe(observation, start)
        assert np.array_equal(after[:, : len(FEATURES)], before)
    memories = more.memories()
    known = more.update(drive[-1])
    value, deviation = known.estimates()["belt_advance"]
    assert after.shape == (COUNT, len(FEATURES) + 3) and (np.abs(value) < 0.5).all()
    assert tuple(known.status()) == tuple(known.nis()) == (*ESTIMATORS, "belts")
    assert known.provided["belts"] == ("belt_advance",)
    assert more.parts["belts"].mass == pytest.approx(
        known.estimates()["mass"][0]
    )  # of this step, not the one before
    other = IdentificationStack(count=COUNT, further=["belts"])
    other.restore(memories)
    assert np.array_equal(other.update(drive[-1]).estimates()["belt_advance"][0], value)
    assert deviation == pytest.approx(1.0 / np.sqrt(more.parts["belts"].memory[:, 0]))
    more.reset()
    assert not more.parts["belts"].memory.any()


def test_every_declared_need_is_a_channel_or_provided_by_another_estimator():
    stack = IdentificationStack()
    for name, part in stack.parts.items():
        others = [other.provides for other in stack.parts.values() if other is not part]
        provided = {quantity.name for own in others for quantity in own}
        assert set(part.needs) <= {*CHANNELS} | provided, name
        assert all(quantity.unit for quantity in part.provides)
    units = {q.name: q.unit for part in stack.parts.values() for q in part.provides}
    assert all(units[name] == RANGES[name].unit for name in units if name in RANGES)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_estimator_reads_the_channels_that_it_needs_and_no_other(name, drive):
    given, spoilt, reader = (IdentificationStack(count=COUNT) for _ in range(3))
    part, other = given.parts[name], spoilt.parts[name]
    unread = [channel not in part.needs for channel in CHANNELS]
    known = []
    for observation in drive:
        reading = reader.reader.read(observation)
        measurement = reading.paired if part.paired else reading.latest
        known.append(part.update(measurement))
        measurement.values[:, unread] = np.nan
        for spoilt_part, whole in zip(other.update(measurement), known[-1], strict=True):
            np.testing.assert_array_equal(spoilt_part, whole)
    assert np.ptp([estimate.value[:, -1] for estimate in known]) > 0.0  # something was estimated


@pytest.mark.parametrize(
    ("changes", "further", "says"),
    [
        ({"needs": ("v_x", "wind")}, ["belts"], r"'belts' needs \['wind'\]; that is no sensor"),
        ({"provides": (Quantity("mass", "kg"),)}, ["belts"], r"provides \['mass'\], which is"),
        ({}, ["bells"], r"'bells' is not registered, .* registered are \['actuators', 'belts'\]"),
        ({}, ["belts", "belts"], r"'belts' is not registered, or named twice"),
    ],
)
def test_an_estimator_that_does_not_fit_is_refused(changes, further, says, registries):
    stacks.register("belts", type("Odd", (BeltAdvance,), changes))
    with pytest.raises(ValueError, match=says):
        IdentificationStack(further=further)
    for taken in ("belts", "slip"):
        with pytest.raises(ValueError, match=f"estimator '{taken}' is registered already"):
            stacks.register(taken, BeltAdvance)


class WheelSlip(Simple):
    """Latest slip of the left belt against a fifth wheel beside it."""

    provides = (Quantity("wheel_slip", "-"),)
    needs = ("wheel_speed", "sprocket_speed_left")
    paired = False

    def update(self, measurement):
        wheel = measurement.channel("wheel_speed")
        belt = self.radius * measurement.channel("sprocket_speed_left")
        new = measurement.fresh[:, DRIVE] & np.isfinite(wheel)
        self.memory[new, 0] = 1.0 - (wheel / np.where(np.abs(belt) > 0.1, belt, np.inf))[new]
        status = np.where(new, Status.CONVERGING, Status.REJECTED)
        return self.estimate(self.memory[:, 0].copy(), np.ones(len(new)), status)


def left_side_speed(truth):
    """Speed over ground of the left side of the hull."""
    return truth["v_x"] - 0.5 * truth["track_gauge"] * truth["yaw_rate"]


@pytest.fixture
def wheel(registries):
    """A channel of the drive clock without noise, its group, and an estimator that needs it."""
    sensors.register(Channel("wheel_speed", "drive", "m/s", truth=left_side_speed))
    layout.register(
        layout.Group("wheel", (layout.Field("wheel_speed", "m/s", 2.0, 40.0, "left wheel"),))
    )
    stacks.register("wheel", WheelSlip)


@pytest.mark.parametrize("paired", [False, True])
def test_an_estimator_reads_a_registered_channel_in_si_units_wherever_its_group_stands(
    paired, wheel, monkeypatch
):
    monkeypatch.setattr(WheelSlip, "paired", paired)
    groups = ("wheel", *layout.VERSIONS["v0"])
    plain = IdentifiedVectorObservation(
        TrackedVehicleVectorEnv(COUNT, sensors="ideal"), IdentificationStack(count=COUNT)
    )
    env = IdentifiedVectorObservation(
        TrackedVehicleVectorEnv(COUNT, sensors="ideal", observation=groups, expose_truth=True),
        IdentificationStack(count=COUNT, further=["wheel"]),
    )
    one, (other, _info) = plain.reset(seed=0)[0], env.reset(seed=0)
    for k in range(60):
        given = len(layout.NAMES) + len(FEATURES)
        assert np.array_equal(other[:, 1 : 1 + given], one)
        action = np.tile(np.float32([0.3 + 0.001 * k, 0.2]), (COUNT, 1))
        one, (other, *_, info) = plain.step(action)[0], env.step(action)
    truth = info["truth"]
    belt = truth["sprocket_radius"] * truth["sprocket_speed_left"]
    slip = other[:, -3]  # before its deviation and excitation
    assert slip == pytest.approx(1.0 - left_side_speed(truth) / belt, abs=1e-5)
    assert (slip > 5e-4).all()


def test_a_channel_that_is_not_shown_or_has_no_field_is_named_and_a_missing_sample_is_no_error(
    wheel, registries
):
    stack = IdentificationStack(count=COUNT, further=["wheel"])
    assert stack.needs[-1] == "wheel_speed"
    with pytest.raises(ValueError, match=r"lacks group wheel \(wheel_speed\).*observation=\["):
        IdentifiedVectorObservation(TrackedVehicleVectorEnv(COUNT), stack)
    with pytest.raises(ValueError, match=r"must be \(4, 32\) \(the last for wheel_speed\)"):
        stack.update(np.zeros((COUNT, layout.SIZE), dtype=np.float32))
    observation = np.zeros((COUNT, layout.SIZE + 1), dtype=np.float32)
    observation[1, -1] = np.nan
    rejected = stack.update(observation, START).status()["wheel"] == Status.REJECTED
    assert rejected.tolist() == [False, True, False, False]
    del layout.GROUPS["wheel"]
    with pytest.raises(ValueError, match=r"needs \['wheel_speed'\]; .*no registered field"):
        IdentificationStack(further=["wheel"])
