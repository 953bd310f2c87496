"""Options of `tracked-env evaluate` and evaluate.py, a configuration from them, and lists of what
they may name."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, NamedTuple

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import frozen
from tracked_env.benchmark.benchmark_config import OF_SET, SUFFIX, BenchmarkConfig, on_id, read_sets
from tracked_env.benchmark.evaluation_sets import (
    SETS,
    BenchmarkSet,
    default_sets,
    group_of,
    tuning_sets,
    version_of,
)
from tracked_env.benchmark.executors import Shard, parse_shard
from tracked_env.benchmark.policies import ids_of, registered_policies
from tracked_env.benchmark.policy_interface import SEED_MARK
from tracked_env.cli.command_line import (
    EnvironmentOptions,
    Parser,
    add_field,
    as_argument,
    from_fields,
    option,
    vehicle_spec,
)
from tracked_env.entry_points import OURS
from tracked_env.environment_ids import (
    PUBLISHED,
    arguments_of,
    bare,
    checked_arguments,
    find_id,
    published_id,
)
from tracked_env.validation import alternatives, checked_choice, name_or_json

DESCRIPTION = """Compare policies on the same randomized tracked vehicles, soils and references.

Every policy meets the same vehicles, soils, references and sensor noise. The summary says, per
uncertainty set, how far each policy is from the reference, and whether the first one is clearly
worse than the others; the leaderboard orders them by score. Results go to a folder named after
the configuration, under OUTPUT: results.json, episodes.csv, summary.md, leaderboard.html and
figures.

Where neither policies nor sets are named, a few policies drive a few episodes of four sets, in
about a minute: a first look. --all compares everything that is registered, on all sets.

An interrupted run loses at most the chunk of episodes in progress; run it again to continue.
"""
ENVIRONMENTS = PUBLISHED
EPISODES, EPISODES_AT_FIRST = 32, 16  # of each set; with fewer than 16 there is no verdict
# Options of what drives a single episode.
EPISODE = ("env", "vehicle", "env_args", "seed", "sensors", "reference", "duration", "lateral")


class FirstLook(NamedTuple):
    """What is compared where neither policies nor sets are named."""

    policies: tuple[str, ...]
    sets: tuple[str, ...]  # one of each group of the frozen version


FIRST_LOOKS = {
    TORQUE_ID: FirstLook(
        ("integral", "adaptive", "mpc-adaptive", "oracle", "any-vehicle@0", "ppo-blind@0"),
        ("often-outages-all", "often-drives", "patches-loose", "often-fast-loads"),
    ),
    SPEED_ID: FirstLook(
        ("slc", "slc-adaptive", "mpc-adaptive", "slc-oracle", "learned-slip@0", "ppo-reckoned@0"),
        ("often-floors-no-velocity", "often-floors", "slow-drives-late", "often-floors-fast"),
    ),
    TERRAIN_ID: FirstLook(
        ("uc", "slc", "slc-adaptive", "slc-oracle", "learned-slip@0", "ppo-reckoned@0"),
        ("often-hills-outages", "often-slope", "boxes", "often-hills-fast"),
    ),
}


# What drives, is shown or recorded for one episode where no set is named: a plain one.
PLAIN = {TORQUE_ID: "payload", SPEED_ID: "friction", TERRAIN_ID: "slope"}


def first_policies(env: str, registered: Sequence[str]) -> tuple[str, ...]:
    """Those of the first look that are registered, all that are where there are fewer than two."""
    first = FIRST_LOOKS[published_id(env)].policies
    there = [name for name in first if name.partition(SEED_MARK)[0] in registered]
    return tuple(there if len(there) > 1 else registered)


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas, empty ones left out; a file whose name has a comma is one."""
    source = text.rpartition("=")[2]
    parts = (text,) if Path(source).exists() else text.split(",")
    return tuple(part for part in parts if part)


class Chosen(NamedTuple):
    """The sets that a command line means."""

    env: str  # their environment id
    names: tuple[str, ...]  # none: those that the command drives by default
    own: dict[str, BenchmarkSet]  # of files


def chosen_sets(env: str | None, sets: Sequence[str] | None, option: str = "--sets") -> Chosen:
    """The environment id that is named, else that of the first named set, else Torque-v0; and sets.

    sets: names, and files, whose sets are all meant where none of them is named. option: that names
    the sets. Raises ValueError for unknown sets and for those of another id, OSError for a file.
    """
    env = env and find_id(env)
    expected, cause = env, f"--env {bare(env or '')}"
    words, own = list[str](), dict[str, BenchmarkSet]()
    for word in sets or ():
        if word.endswith(SUFFIX):
            of_file = {each.name: each for each in read_sets(word, env or TORQUE_ID)}
            named = {*(sets or ())} & of_file.keys()
            words += [] if named else of_file
            own |= of_file
        else:
            words.append(word)
    names = tuple(dict.fromkeys(words))
    for name in names:
        known = {**SETS, **own}
        here = (env, env and published_id(env))
        if name not in known:
            candidates = [each.name for each in known.values() if env is None or each.env in here]
            near = alternatives(name, candidates).rpartition("].")[2]
            raise ValueError(
                f"unknown evaluation set {name!r}; `tracked-env envs` lists the {len(candidates)} "
                f"sets of {env or 'the environments'}.{near}"
            )
        of = known[name].env
        if expected is None:
            expected, cause = of, f"{name!r} of {bare(of)}"
        if of not in (expected, published_id(expected)):
            raise ValueError(
                f"{option} {name!r} is of {bare(of)}, which contradicts {cause}; must "
                "be of one environment: `tracked-env envs` lists them"
            )
    return Chosen(expected or TORQUE_ID, names, own)


def env_of(env: str | None, sets: Sequence[str] | None) -> str:
    """The environment id of `chosen_sets`."""
    return chosen_sets(env, sets).env


@dataclass(frozen=True)
class Config(EnvironmentOptions):
    """What to compare, on what, and where the results go."""

    env: str | None = None
    """Environment id, ours with or without `tracked_env/`: sprocket torques as actions, or speeds,
    on level ground or on slopes (default: that of the sets that are named, else Torque-v0); or an
    id of your own, as module:namespace/Name-v0."""

    policies: tuple[str, ...] | None = option(None, metavar="POLICY", type=names)
    """Policies to compare, separated by spaces or commas; the first one is the baseline. By
    default, where sets are named, all that are registered for the environment: `tracked-env
    policies` lists them. NAME: a registered controller or agent, with all its seeds. NAME@SEED: one
    of them. path/to/agent.zip: an agent of train.py, or, with --trust, any other archive of
    Stable-Baselines3. NAME=runs/ppo-*/agent.zip: the seeds of one agent, summarised together.
    module:attribute: any object with a `predict` as in Stable-Baselines3, or what makes one; it is
    imported and run."""

    trust: bool = False
    """Open archives that hold pickled objects too, those of Stable-Baselines3 itself. Opening one
    runs any code that its author put there: only for authors whom you trust. Agents of train.py
    hold none and need it not."""

    sets: tuple[str, ...] | None = option(None, metavar="SET", type=names)
    """Evaluation sets: laws of vehicle, soil and changes, and sensors, separated by spaces or
    commas. By default, where policies are named, all of the environment but the known ones:
    `tracked-env envs` lists them. FILE.toml: sets of your own, all, or those that are named too."""

    all: bool = False
    """All policies that are registered, unless some are named, on all sets, unless some are
    named."""

    sets_version: str | None = option(None, metavar="VERSION")
    """Version of the frozen sets, such as v2; by default the newest one that holds them."""

    episodes: int | None = option(None, metavar="N")
    """Episodes per set, 1 or more (default: 32, and 16 where neither policies nor sets are named);
    the frozen ones are the first 100 of each."""

    seed: int = 0
    """Seed of the first episode, 0 or more; of the frozen ones it is 0."""

    sensors: str | None = None
    """Instead of the sensors of each set: ideal, rtk, strawa, mocap, or JSON:
    '{"preset": "rtk", "pose_delay": 0.1}'."""

    reference: str | None = None
    """Instead of the reference of each set: random, mixed, circle, figure_eight, straight, spiral,
    chicane, identification, or JSON: '{"kind": "circle", "radius": 10, "speed": 2}'."""

    duration: float | None = None
    """Instead of the length of the episodes of each set [s], 0.1 to 3600."""

    lateral: Literal["sliding", "constrained"] | None = None
    """Lateral constraint of the plant: sliding tracks (by default), or the ICR held at a constant
    distance as in the original paper."""

    output: Path = Path("results")
    """Folder for results; each configuration gets its own in it, which one evaluation at a time may
    write."""

    figures: bool = True
    """Draw paths, errors, torque and slip as SVG, on the page too."""

    video: bool = False
    """Record the first episode of the first set, every policy."""

    quiet: bool = False
    """Show neither progress nor tables: only where the results are."""

    paper: Literal["none", "strawa2021", "focchi2025"] = "none"
    """Instead of the benchmark, run a paper's experiments again: its claims beside what comes out,
    its figures, one page; needs a clone of the repository."""

    chunk: int = 64
    """Episodes run and stored together, 1 or more; numbers do not change."""

    workers: int | None = option(None, metavar="N")
    """Processes of this machine that run chunks at the same time, 1 or more. By default this
    process alone."""

    shard: Shard | None = option(  # noqa: RUF009, a field
        None, type=as_argument(parse_shard), metavar="I/N"
    )
    """Run part I of N of the chunks, in one of N independent processes, as in an array of SLURM;
    the same command without it merges them and writes the tables."""

    ray: str | None = option(None, metavar="ADDRESS")
    """Run the chunks on a Ray cluster (extra `cluster`): local, auto or HOST:PORT."""

    @property
    def is_first_look(self) -> bool:
        """Whether neither policies nor sets are named, nor all of them asked for."""
        return not (self.policies or self.sets or self.sets_version or self.all)


FIELDS = tuple(each.name for each in fields(Config))


def add_option(parser: Any, name: str, text: str | None = None, **changed: Any) -> None:
    """A field of Config as an option; text, changed: as in `add_field`."""
    add_field(parser, Config, name, text, **changed)


def add_env(parser: Any, envs: Sequence[str] = ENVIRONMENTS, **changed: Any) -> None:
    """The option --env of a command for these environments; changed: as in `add_field`."""
    short = [bare(env) for env in envs]

    def env_named(text: str) -> str:
        if envs is ENVIRONMENTS:
            return find_id(text)
        return f"tracked_env/{checked_choice('environment', bare(text), short)}"

    words = "{" + ",".join(short) + "}" + ("|MODULE:ID" if envs is ENVIRONMENTS else "")
    add_option(parser, "env", type=as_argument(env_named), metavar=words, **changed)


def add_options(parser: Any, names: Sequence[str] = FIELDS) -> None:
    """Fields of Config as options."""
    for name in names:
        if name == "env":
            add_env(parser)
        else:
            add_option(parser, name)


def add_episode_options(parser: Any) -> None:
    """Options of what drives a single episode: those of EPISODE, and --set."""
    text = (
        f"evaluation set (default: {', '.join(PLAIN.values())}, by the environment; of your own "
        "id its first one), or one of your own: FILE.toml, or FILE.toml,SET where it has several"
    )
    parser.add_argument("--set", type=names, help=text)
    add_options(parser, EPISODE)


def config_of(namespace: argparse.Namespace) -> Config:
    """The options of a command line; one set where `namespace.set` names it."""
    if "set" in namespace:
        chosen = chosen_sets(namespace.env, namespace.set, "--set")
        if len(chosen.names) > 1:
            raise ValueError(
                f"--set {','.join(namespace.set)} is {len(chosen.names)} sets, "
                f"{', '.join(chosen.names)}; must be one: FILE.toml,SET names it"
            )
        namespace.env, namespace.sets = (
            chosen.env,
            namespace.set or usual_sets(chosen.env, "episode")[:1],
        )
    return from_fields(Config, namespace)


def usual_sets(env: str, use: str = "evaluation", version: str | None = None) -> tuple[str, ...]:
    """The sets of an id where none is named: its own ones, else those of its published id.

    use: of the published ones, "evaluation", "first look", "tuning" or "episode", a single one.
    """
    own = tuple(name for name, each in SETS.items() if each.env == env)
    if env not in PUBLISHED and own:
        return own
    published = published_id(env)
    if use == "first look":
        return FIRST_LOOKS[published].sets
    if use == "episode":
        return (PLAIN[published],)
    return tuning_sets(published) if use == "tuning" else default_sets(published, version)


def further_arguments(config: EnvironmentOptions, env: str) -> dict[str, Any]:
    """What --env-args says of the environment of an id. Raises ValueError."""
    value = name_or_json(config.env_args, "env-args")
    if isinstance(value, dict) and "uncertainty" in value:
        raise ValueError(
            "--env-args: uncertainty is that of the sets; must be left out. Did you mean a set of "
            "your own (--sets FILE.toml)?"
        )
    return checked_arguments("--env-args", env, value, (*OF_SET, "lateral", "vehicle"))


def benchmark_settings(config: Config, use: str | None = None) -> dict[str, Any]:
    """`sets` of BenchmarkConfig, and what of a user's own goes into them.

    use: as in `usual_sets`, by default what the options say. Raises ValueError.
    """
    env, names, own = chosen_sets(config.env, config.sets)
    further = further_arguments(config, env)
    use = use or ("first look" if config.is_first_look else "evaluation")
    names = names or usual_sets(env, use, config.sets_version)
    for name in names:
        entry = own.get(name, SETS.get(name))
        assert entry is not None  # of chosen_sets
        if entry.env != env:
            entry = own[name] = on_id(entry, env)
        if further:
            own[name] = entry._replace(arguments={**entry.arguments, **further})
    settings: dict[str, Any] = {"sets": names, "vehicle": vehicle_spec(config.vehicle)}
    settings["own_sets"] = tuple(own[name] for name in names if name in own)
    for key in ("control_rate", "lateral"):
        usual, first = arguments_of(env)[key], names[0]
        values = {
            name: own[name].arguments.get(key, usual) if name in own else usual for name in names
        }
        for name in (each for each in names if values[each] != values[first]):
            raise ValueError(
                f"{key} = {values[first]!r} in set {first!r} and {values[name]!r} in set {name!r}; "
                "must be the same in all sets of one comparison"
            )
        settings[key] = values[first]
    return settings | ({"lateral": config.lateral} if config.lateral else {})


def benchmark_config(config: Config) -> BenchmarkConfig:
    """The part of the command line that the benchmark knows. Raises ValueError."""
    usual = EPISODES_AT_FIRST if config.is_first_look else EPISODES
    return BenchmarkConfig(
        episodes=usual if config.episodes is None else config.episodes,
        seed=config.seed,
        reference=name_or_json(config.reference, "reference"),
        sensors=name_or_json(config.sensors, "sensors"),
        duration=config.duration,
        chunk=config.chunk,
        version=config.sets_version,
        **benchmark_settings(config),
    )


def episode_config(namespace: argparse.Namespace) -> BenchmarkConfig:
    """The same from the command line of what drives a single episode. Raises ValueError."""
    return benchmark_config(config_of(namespace))


def parsed(arguments: Sequence[str] | None, program: str) -> Config:
    """The configuration of a command line; exits with a message for one that is wrong."""
    parser = Parser(program, DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser)
    return config_of(parser.parse_args(arguments))


def policy_lines(envs: Sequence[str]) -> Iterator[str]:
    """The policies that are registered for these environments, and for any, a line each."""
    registered = registered_policies()
    width = max((len(policy.name) for policy in registered), default=0)
    ids = dict.fromkeys(each for of in envs for each in ids_of(of))
    for env in (*ids, None):
        here = [policy for policy in registered if policy.env == env]
        if here:
            yield env or "any environment"
        for policy in here:
            origin = "" if policy.distribution == OURS else f"  [{policy.distribution}]"
            yield f"  {policy.name:<{width}}  {policy.summary}{origin}"


def env_lines(envs: Sequence[str]) -> Iterator[str]:
    """The environments with drive, vehicle and plant, and their evaluation sets, a line each."""
    for env in envs:
        of = arguments_of(env)
        yield (
            f"{env}  actions: sprocket {of['drive']}s; vehicle {of['vehicle']}; "
            f"{of['plant']} plant; sensors {of['sensors']}"
        )
        version = version_of(published_id(env))
        stored = {} if version is None else frozen.stored(version)["sets"]
        sets = [name for name, each in SETS.items() if each.env == env]
        width = max(map(len, (*usual_sets(env), *sets)))
        for each in (SETS[name] for name in dict.fromkeys((*usual_sets(env), *sets))):
            sensors = each.sensors if isinstance(each.sensors, str) else dict(each.sensors)
            mark = "not by default"
            if version is not None and each.name in stored:
                group, digest = group_of(each.name, version), stored[each.name]["hash"]
                mark = f"{version.name}, {group}, version {each.version}, hash {digest}"
            yield f"  {each.name:<{width}}  {each.uncertainty}, sensors {sensors}  [{mark}]"


def list_main(arguments: Sequence[str], program: str) -> int:
    """`tracked-env policies` and `tracked-env envs`; returns the exit status."""
    lists_policies = program.endswith("policies")
    text = "List the environments and their evaluation sets."
    if lists_policies:
        text = "List the policies that are registered, with all their seeds."
    parser = Parser(program, text)
    add_env(parser, text="of this environment alone (default: all)", default=None)
    env = parser.parse_args(arguments).env
    envs = ENVIRONMENTS if env is None else (env,)
    print("\n".join(policy_lines(envs) if lists_policies else env_lines(envs)))
    return 0
