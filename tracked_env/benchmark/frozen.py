"""Are these the episodes of the version? Digests of what is drawn, compared with those kept.

Of every set, the first `Version.episodes` are drawn, and a digest taken of all that they are:
vehicle, soil, changes, reference, start, sensors, seed of the noise, in versions with groups also
of plant, drive, vehicle and duration, and of a fleet what policies are told. Numbers enter it with
6 significant digits, and as 0 below FLOOR: the last bits, and what should be 0, depend on the
processor, because BLAS adds in another order on each. The equations of motion are not in it, so the
first DRIVEN episodes are driven for a moment with a constant action, and the mean of where they end
and of what is then seen is compared as well. The kept numbers are made by `python -m
tracked_env.benchmark.frozen VERSION > FILE`, once per version, and with `--sets NAME` once per
version of a set in groups: the numbers of all other sets stay.
"""

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import evaluation_sets as es
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import SEED, SETS, Version, names_of
from tracked_env.benchmark.runner import feed
from tracked_env.validation import checked_choice

DRIVEN = 8  # episodes
DRIVEN_STEPS = 100  # [control steps]
ACTION = (0.35, 0.45)  # [-] left, right: drives off in a wide left turn
BITS = 20  # of the mantissa that count, about 6 significant digits; kernels of BLAS differ by 6e-14
FLOOR = 1e-9  # [SI] a smaller number is rounding of 0
TOLERANCE = 1e-5  # [-] relative, of the driven numbers: far above rounding, far below a change
# What a configuration may not say differently, with what it is in every version.
FIXED = dict.fromkeys(("reference", "sensors", "duration", "error_limit"))
FIXED |= {"seed": SEED, "control_rate": 50.0, "lateral": "sliding"}


class Check(NamedTuple):
    """Whether results can be compared with those of others who name the same version."""

    version: str
    hash: str  # of the kept digests of all sets
    comparable: bool
    message: str  # for a person


def rounded(values: Any) -> NDArray[Any]:
    """`values` with BITS of the mantissa, 0 below FLOOR; integers as they are."""
    array = np.asarray(values)
    if array.dtype.kind != "f":
        return array
    array = np.where(np.abs(array) < FLOOR, 0.0, array.astype(np.float64))
    mantissa, exponent = np.frexp(array)
    return np.ldexp(np.round(np.ldexp(mantissa, BITS)), exponent - BITS) + 0.0  # no -0


def draw(name: str, version: Version | None = None) -> dict[str, Any]:
    """Digest of the episodes of a set as drawn now: {"hash": digest, "driven": numbers}.

    version: knows which fields count; None for the newest one with the set.
    """
    config = BenchmarkConfig(sets=(name,))
    digest = hashlib.sha256()
    version = version or config.frozen_version
    assert version is not None
    if version.groups:  # episodes do not hold their plant
        arguments = {**SETS[name].arguments, "duration": SETS[name].duration}
        digest.update(json.dumps(arguments, sort_keys=True).encode())
    for chunk in config.batches(name, version.episodes, version.episodes):
        env, _ = _begun(config, name, chunk)
        episodes = (es.of_version(each, version) for each in env.simulation.episodes if each)
        told = config.context(name, chunk[0]).vehicle if SETS[name].fleet else ()
        feed(digest, (*episodes, *told), rounded)
        env.close()
    ends = [_driven(config, name, chunk) for chunk in config.batches(name, DRIVEN, DRIVEN)]
    numbers = [float(f"{values.mean():.8g}") for values in np.concatenate(ends, axis=1)]
    return {"hash": digest.hexdigest()[:12], "driven": numbers}


def _begun(config: BenchmarkConfig, name: str, chunk: range) -> tuple[Any, Any]:
    """A batch of these episodes, and what it shows first."""
    env = config.environment(name, len(chunk), truth=False, episode=chunk[0])
    options = config.options(name, chunk)
    first = config.first_seed(name)
    return env, env.reset(seed=[first + i for i in chunk], options=options)[0]


def _driven(config: BenchmarkConfig, name: str, chunk: range) -> NDArray[np.float64]:
    """(5, n) magnitudes of where these episodes are after DRIVEN_STEPS, and of what is seen."""
    env, observation = _begun(config, name, chunk)
    action = np.tile(np.array(ACTION, np.float32), (len(chunk), 1))
    for _ in range(DRIVEN_STEPS):
        observation, *_ = env.step(action)
    ends = [np.abs(env.simulation.batch.column(name)) for name in ("x", "y", "yaw", "v_x")]
    ends.append(np.abs(observation.astype(np.float64)).sum(axis=1))
    env.close()
    return np.array(ends)


def total(sets: Mapping[str, Mapping[str, Any]]) -> str:
    """One hash of the digests of all sets."""
    text = json.dumps({name: sets[name]["hash"] for name in sorted(sets)})
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def stored(version: Version = es.PLANAR) -> dict[str, Any]:
    """The numbers of a version, as they are in the package."""
    text = files("tracked_env.benchmark").joinpath(version.file).read_text(encoding="utf-8")
    return dict(json.loads(text))


def _changed(name: str, kept: Mapping[str, Any], version: Version) -> str:
    """In what a set is no longer what it was, in words; empty for one that is the same.

    kept: the digests of all sets of the version.
    """
    now, then = draw(name, version), kept.get(name, {"hash": "", "driven": 0.0})
    old, new = then.get("version", 1), SETS[name].version
    if old != new:
        return f"{name} (version {new}, kept is {old})"
    if now["hash"] != then["hash"]:
        return f"{name} (other episodes)"
    same = np.allclose(now["driven"], then["driven"], rtol=TOLERANCE, atol=0.0)
    return "" if same else f"{name} (same episodes, driven or measured differently)"


def check(config: BenchmarkConfig) -> Check:
    """Compare the sets of a configuration with those of the version."""
    version = config.frozen_version
    own = {name: getattr(config, name) for name in FIXED}
    settings = [f"{name} = {value!r}" for name, value in own.items() if value != FIXED[name]]
    settings += [] if config.vehicle is None else ["another vehicle"]
    own_sets = [each.name for each in config.own_sets]
    of_version = () if version is None else {*names_of(version)} - {*own_sets}
    others = [f"set {name}" for name in config.sets if name not in of_version]
    deviations = ", ".join(settings + others)
    if version is None:
        return Check("-", "-", False, f"sets of your own: {deviations}")
    document = stored(version)
    answer = Check(version.name, document["hash"], False, "")
    if deviations:
        return answer._replace(message=f"sets of your own, not {version.name}: {deviations}")
    mark = f"{version.name}, hash {document['hash']}"
    changes = [_changed(name, document["sets"], version) for name in config.sets]
    if changed := ", ".join(filter(None, changes)):
        text = (
            f"WARNING: results are NOT comparable with {mark}: {changed}. Either the source of the "
            "simulation, of a law or of a set has changed (then it needs a new version), or NumPy "
            f"{np.__version__} draws other random numbers than NumPy {document['numpy']}, with "
            "which the version was made."
        )
        return answer._replace(message=text)
    if config.episodes > version.episodes:
        text = f"sets {mark}, but only the first {version.episodes} of {config.episodes} episodes"
        return answer._replace(message=text)
    part = config.episodes < version.episodes
    share = f", first {config.episodes} of {version.episodes}" if part else ""
    text = f"sets {mark}, {config.episodes} episodes each{share}"
    return answer._replace(comparable=True, message=text)


def document(version: Version, sets: Sequence[str] = ()) -> dict[str, Any]:
    """The stored record of a version, from the episodes as drawn now.

    sets: those that are drawn, all others keep their numbers; none: all are drawn. Raises
    ValueError for one that the version does not hold.
    """
    names = names_of(version)
    for name in sets:
        checked_choice(f"evaluation set of {version.name}", name, names)
    entries = dict(stored(version)["sets"]) if sets else {}
    for name in names:
        if name not in entries or name in sets:
            group = {"version": SETS[name].version, "group": es.group_of(name, version)}
            entries[name] = {**(group if version.groups else {}), **draw(name, version)}
    entries = {name: entries[name] for name in names}
    return {
        "version": version.name,
        "hash": total(entries),
        "numpy": np.__version__,
        "episodes": version.episodes,
        "seed": SEED,
        "sets": entries,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Print the digests of a version of the sets.")
    parser.add_argument("version", choices=tuple(es.VERSIONS))
    parser.add_argument("--sets", nargs="+", default=(), help="draw these; all others stay")
    options = parser.parse_args()
    print(json.dumps(document(es.VERSIONS[options.version], options.sets), indent=1))
