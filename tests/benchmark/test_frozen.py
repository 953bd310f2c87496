"""The frozen sets and the splits of seeds: what is drawn is what was drawn, none is shared."""

import json
import re
from itertools import combinations, pairwise

import numpy as np
import pytest

from agents.folder import HELD_OUT_SEED
from agents.run import ROWS, TRAININGS, random_seed
from tests.processes import python
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID, uncertainty
from tracked_env.benchmark import SETS, BenchmarkConfig, check, frozen
from tracked_env.benchmark import evaluation_sets as es
from tracked_env.benchmark.runner import episode_digest
from tracked_env.env import TrackedVehicleEnv
from tracked_env.environment_ids import PUBLISHED
from tracked_env.sensors import UNMEASURED, make_sensors

TORQUE_V3, SPEED_V3, TERRAIN_V3 = V3 = [
    es.VERSIONS[f"{n}-v3"] for n in ("torque", "speed", "terrain")
]
IN_GROUPS = [*es.NEWEST, *V3, es.UNLIKE_SETS]
ONE = BenchmarkConfig(sets=("slow-drive",), episodes=es.EPISODES)


@pytest.mark.parametrize(
    ("env", "version"),
    [
        *(
            pytest.param(*closed, marks=pytest.mark.slow)
            for closed in ((TORQUE_ID, es.PLANAR), (SPEED_ID, es.PLANAR), (TERRAIN_ID, es.SLOPES))
        ),
        *(pytest.param(env, es.VEHICLE_SETS, marks=pytest.mark.slow) for env in PUBLISHED),
        (SPEED_ID, es.GOAL_REACHING),
        *((version.envs[0], version) for version in IN_GROUPS),
    ],
)
def test_every_set_draws_the_episodes_of_the_version(env, version):
    of_env = tuple(name for name in es.names_of(version) if SETS[name].env == env)
    count = version.episodes
    answer = check(BenchmarkConfig(sets=of_env, episodes=count, version=version.name))
    assert answer.comparable, answer.message
    assert es.version_of(env, of_env, version.name) is version
    assert answer.message == f"sets {version.name}, hash {answer.hash}, {count} episodes each"


def test_the_kept_files_hold_every_set_and_their_own_hash():
    documents = [frozen.stored(version) for version in es.VERSIONS.values()]
    assert {name for document in documents for name in document["sets"]} == set(es.OF_VERSION)
    for version, document in zip(es.VERSIONS.values(), documents, strict=True):
        assert document["version"] == version.name
        assert document["hash"] == frozen.total(document["sets"])
        assert list(document["sets"]) == list(es.names_of(version))
        hashes = {entry["hash"] for entry in document["sets"].values()}
        assert len(hashes) == len(document["sets"])


@pytest.mark.parametrize("version", IN_GROUPS, ids=lambda version: version.name)
def test_a_version_in_groups_has_ten_to_twelve_sets_in_four_of_them(version):
    assert tuple(version.groups) == ("memory", "identification", "mismatch", "out-of-distribution")
    assert 10 <= len(set(version.sets)) == len(version.sets) <= 12
    for name, entry in frozen.stored(version)["sets"].items():
        assert (entry["group"], entry["version"]) == (
            es.group_of(name, version),
            SETS[name].version,
        )
    assert es.default_sets(version.envs[0], version.name) == version.sets
    assert (es.default_sets(version.envs[0]) == version.sets) is (version in es.NEWEST)


def test_to_change_one_set_changes_its_hash_and_no_other(monkeypatch):
    monkeypatch.setattr(frozen, "DRIVEN", 2)
    few = es.in_groups(
        "few", TORQUE_ID, {"memory": ("late-gains", "alternating", "rare-pose-mixed")}
    )._replace(episodes=3)
    before = frozen.document(few)
    changed = SETS["alternating"]._replace(sensors="strawa", version=2)
    monkeypatch.setitem(SETS, "alternating", changed)
    monkeypatch.setattr(frozen, "stored", lambda version: before)
    after, drawn_anew = frozen.document(few, ["alternating"]), frozen.document(few)
    assert after == drawn_anew
    before["sets"]["late-gains"]["driven"][0] += 1.0
    kept = frozen.document(few, ["alternating"])["sets"]["late-gains"]
    assert kept == before["sets"]["late-gains"]  # not drawn again
    before["sets"]["late-gains"]["driven"][0] = after["sets"]["late-gains"]["driven"][0]
    differ = [name for name in few.sets if after["sets"][name] != before["sets"][name]]
    assert differ == ["alternating"]
    assert after["sets"]["alternating"]["version"] == 2
    assert after["sets"]["alternating"]["hash"] != before["sets"]["alternating"]["hash"]
    assert after["hash"] != before["hash"]
    with pytest.raises(ValueError, match="payload"):
        frozen.document(few, ["payload"])


def test_a_set_of_another_version_than_the_kept_one_is_not_comparable(monkeypatch):
    monkeypatch.setitem(SETS, "alternating", SETS["alternating"]._replace(version=2))
    answer = check(BenchmarkConfig(sets=("alternating",), episodes=2))
    assert not answer.comparable
    assert "alternating (version 2, kept is 1)" in answer.message


def test_a_version_is_named_or_is_the_newest_one_with_all_the_sets():
    assert es.version_of(TORQUE_ID) is es.TORQUE_SETS and es.version_of(SPEED_ID) is es.SPEED_SETS
    assert es.version_of(TORQUE_ID, ("distributed",)) is TORQUE_V3
    assert es.version_of(TORQUE_ID, ("distributed", "drift")) is es.PLANAR
    assert es.version_of(TORQUE_ID, ("distributed",), "v2") is es.PLANAR
    assert es.version_of(TORQUE_ID, (), "v3") is TORQUE_V3
    assert es.version_of(TORQUE_ID, (), "torque-unlike-v1") is es.UNLIKE_SETS
    assert es.version_of(TORQUE_ID, ("distributed", "distributed-fast")) is es.UNLIKE_SETS
    assert es.version_of(TERRAIN_ID, (), "v3") is TERRAIN_V3
    assert es.version_of(SPEED_ID, (), "v4") is es.version_of(SPEED_ID) is es.SPEED_SETS
    assert es.version_of(SPEED_ID, (), "goals-v1") is es.GOAL_REACHING
    assert es.version_of(SPEED_ID, ("goals", "goals-step")) is es.GOAL_REACHING
    assert not set(es.GOAL_REACHING.sets) & set(es.default_sets(SPEED_ID, "v2"))
    assert es.default_sets(TORQUE_ID, "v2")[0] == "soil-and-mass"
    with pytest.raises(ValueError, match=r"version of the sets of .*Terrain-v0 'v2'"):
        BenchmarkConfig(sets=("hills",), version="v2")


def test_the_version_of_the_sets_is_no_part_of_what_a_result_is():
    one, other = (BenchmarkConfig(sets=("distributed",), version=v) for v in ("v2", "v3"))
    assert one.identity() == other.identity()
    assert (check(one).version, check(other).version) == ("v2", "torque-v3")


def test_sets_of_two_versions_are_comparable_with_neither():
    sets = ("friction", "goals")
    answer = check(BenchmarkConfig(sets=sets, episodes=es.EPISODES, version="v2"))
    assert not answer.comparable and "set goals" in answer.message


@pytest.mark.parametrize(
    ("version", "published"),
    [(es.PLANAR, "d6cfd4ef1c09"), (es.SLOPES, "c71f88e9d41b"), (es.GOAL_REACHING, "0ceef5c8033b")],
)
def test_the_hash_of_a_version_is_the_one_that_results_were_published_with(version, published):
    assert frozen.stored(version)["hash"] == published
    assert {SETS[name].version for name in es.names_of(version)} == {1}  # it is closed


def test_the_digests_of_slopes_take_in_the_ground_and_those_of_the_plane_do_not_need_it():
    env = BenchmarkConfig(sets=("hills",)).environment("hills", 1, truth=False)
    env.reset(seed=[0])
    (episode,) = env.simulation.episodes
    steeper = episode._replace(relief=(episode.relief[0] + 1e-4, *episode.relief[1:]))
    higher = episode._replace(state=episode.state._replace(z=episode.state.z + 1e-4))
    for changed in (steeper, higher):
        assert es.of_version(changed, es.SLOPES) != es.of_version(episode, es.SLOPES)
    assert es.of_version(higher, es.PLANAR) == es.of_version(episode, es.PLANAR)


def test_fewer_episodes_are_a_part_of_the_version_and_more_are_not_in_it():
    few = check(BenchmarkConfig(sets=("payload",), episodes=32))
    assert few.comparable and "first 32 of 100" in few.message
    assert not check(BenchmarkConfig(sets=("payload",), episodes=101)).comparable


@pytest.mark.parametrize(
    "change",
    [
        *({"seed": 1}, {"sensors": "ideal"}, {"reference": "circle"}, {"duration": 20.0}),
        *({"lateral": "constrained"}, {"control_rate": 25.0}, {"error_limit": 4.0}),
    ],
)
def test_a_configuration_that_deviates_is_not_the_version_and_is_told_in_what(change):
    answer = check(BenchmarkConfig(sets=("payload",), **change))
    assert not answer.comparable
    assert next(iter(change)) in answer.message
    assert len(change) == 1 < len(frozen.FIXED)


def test_a_law_that_draws_otherwise_is_found_and_named(monkeypatch):
    law = uncertainty.UNCERTAINTY_SETS["slow-drive"]

    def slower(*given):
        draw = law(*given)
        lag = draw.parameters.drive_time_constant * (1.0 + 1e-6)
        return draw._replace(parameters=draw.parameters._replace(drive_time_constant=lag))

    monkeypatch.setitem(uncertainty.UNCERTAINTY_SETS, "slow-drive", slower)
    answer = check(ONE)
    assert not answer.comparable
    assert re.search(
        r"NOT comparable.*slow-drive .other episodes.*new version.*NumPy", answer.message
    )


def test_other_dynamics_of_the_same_episodes_are_found(monkeypatch):
    document = frozen.stored()
    document["sets"]["slow-drive"]["driven"][3] *= 1.0 + 1e-4
    monkeypatch.setattr(frozen, "stored", lambda version: document)
    answer = check(ONE)
    assert not answer.comparable
    assert "driven or measured differently" in answer.message


def test_the_last_bit_of_a_number_does_not_change_a_digest_and_a_small_change_does():
    values = np.random.default_rng(0).normal(size=1000) * 10.0 ** np.arange(-5, 5).repeat(100)
    bit = np.nextafter(values, np.inf)
    assert np.all(frozen.rounded(values) == frozen.rounded(bit))
    assert not np.any(frozen.rounded(values) == frozen.rounded(values * (1.0 + 3e-6)))
    assert np.any(frozen.rounded(values) != frozen.rounded(values * (1.0 + 3e-8)))
    assert np.array_equal(frozen.rounded(np.array([6e-14, -3e-18])), [0.0, 0.0])
    assert np.array_equal(frozen.rounded(np.array([-0.0, -np.inf])), [0.0, -np.inf])
    assert not np.signbit(frozen.rounded(-0.0))
    assert frozen.rounded(2**62 + 1) == 2**62 + 1


@pytest.mark.parametrize(
    ("kernels", "version", "name"),
    [
        ("Sandybridge", TORQUE_V3, "noisy-fast"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("Haswell", es.PLANAR, "ood"),
                ("Sandybridge", es.PLANAR, "ood"),
                ("Sandybridge", es.SLOPES, "hills"),
            )
        ),
    ],
)
def test_the_command_that_makes_a_version_prints_what_is_kept_on_every_kind_of_processor(
    kernels, version, name
):
    # OPENBLAS_CORETYPE is read by x86-64 builds of NumPy.
    command = "-m", "tracked_env.benchmark.frozen", version.name
    made = json.loads(python(*command, OPENBLAS_CORETYPE=kernels).stdout)
    kept = frozen.stored(version)
    assert list(made) == list(kept)
    assert made["hash"] == kept["hash"]
    assert made["sets"][name]["driven"] == pytest.approx(kept["sets"][name]["driven"])


def test_a_set_keeps_its_sensors_unless_others_are_given():
    config = BenchmarkConfig(sets=("noisy", "payload"))
    assert config.context("noisy").sensors == make_sensors("strawa")
    assert config.context("payload").sensors == make_sensors("rtk")
    assert BenchmarkConfig(sensors="ideal").context("noisy").sensors == make_sensors("ideal")


def test_an_unmeasured_velocity_reads_zero_and_its_data_sheet_says_so():
    env = TrackedVehicleEnv(sensors={"preset": "rtk", "velocity_measured": 0})
    plain = TrackedVehicleEnv(sensors="rtk")
    seen, _ = env.reset(seed=0)
    other, _ = plain.reset(seed=0)
    for _ in range(20):
        seen, other = (e.step(np.array([0.4, 0.5]))[0] for e in (env, plain))
        assert seen[3:5].tolist() == [0.0, 0.0]
        assert np.all(other[3:5] != 0.0)
        assert np.array_equal(np.delete(seen, [3, 4]), np.delete(other, [3, 4]))
    assert make_sensors({"velocity_measured": 0}).velocity_noise == UNMEASURED
    assert make_sensors(make_sensors("ideal")._replace(velocity_measured=0.0)).velocity_noise == (
        UNMEASURED
    )


@pytest.mark.parametrize(
    ("base", "given"),
    [
        ("rtk", {"velocity_measured": 0.5}),
        ("rtk", {"velocity_measured": 2}),
        ({"velocity_measured": 0}, {"velocity_measured": 1}),
    ],
)
def test_a_velocity_is_measured_or_not_and_nothing_in_between(base, given):
    with pytest.raises(ValueError, match="velocity_measured"):
        make_sensors(given, base=make_sensors(base))


def overlap(one, other):
    return max(one.start, other.start) < min(one.stop, other.stop)


SPLITS = {
    **{"frozen": es.FROZEN, "development": es.DEVELOPMENT},
    **{"audit": es.AUDIT, "observer": es.OBSERVER},
}


def seeds_of(split):
    return range(SPLITS[split], SPLITS[split] + es.LENGTH)


def test_no_two_splits_share_a_seed():
    splits = [seeds_of(name) for name in SPLITS]
    assert not any(overlap(one, other) for one, other in combinations(splits, 2))
    assert [seeds_of(name).start for name in ("development", "audit")] == [
        es.DEVELOPMENT,
        es.AUDIT,
    ]
    assert all(len(split) >= es.EPISODES for split in splits)


def test_trainings_and_their_held_out_episodes_have_seeds_of_no_split():
    held_out = range(HELD_OUT_SEED, HELD_OUT_SEED + ROWS)
    trainings = range(random_seed(0), random_seed(TRAININGS - 1) + ROWS)
    assert not overlap(held_out, trainings)
    for name in SPLITS:
        assert not any(overlap(seeds_of(name), other) for other in (held_out, trainings))


@pytest.mark.parametrize("version", es.VERSIONS)
def test_the_published_episodes_lie_in_the_frozen_split(version):
    """As the kept file of the version says, not the constants of the program."""
    document = frozen.stored(es.VERSIONS[version])
    published = range(document["seed"], document["seed"] + document["episodes"])
    assert published.start == seeds_of("frozen").start
    assert published.stop <= seeds_of("frozen").stop


def test_the_same_set_draws_other_episodes_in_every_split():
    env = BenchmarkConfig(sets=("mixed",)).environment("mixed", 3, truth=False)
    digests = set()
    for first in SPLITS.values():
        env.reset(seed=first)
        digests |= {episode_digest(one) for one in env.simulation.episodes if one is not None}
    env.close()
    assert len(digests) == 3 * len(SPLITS)


def test_no_two_sets_of_the_newest_versions_share_an_episode():
    names = [name for version in es.NEWEST for name in version.sets]
    first = sorted(SETS[name].seed for name in names)
    assert min(later - one for one, later in pairwise(first)) >= es.EPISODES
    assert first[0] >= es.EPISODES and first[-1] + es.EPISODES <= es.LENGTH
    digests = {
        episode_digest(episode)
        for name in names[:2]
        for episode in frozen._begun(BenchmarkConfig(sets=(name,)), name, range(3))[
            0
        ].simulation.episodes
    }
    assert len(digests) == 6
