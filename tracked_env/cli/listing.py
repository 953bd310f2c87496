"""`tracked-env policies` and `tracked-env envs`: one line each."""

from collections.abc import Iterator, Sequence

import gymnasium

from tracked_env.benchmark import frozen
from tracked_env.benchmark.evaluation_sets import SETS, VERSIONS, default_sets, group_of, version_of
from tracked_env.benchmark.policies import registered_policies
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import ENVIRONMENTS, add_env
from tracked_env.engine.env_config import EnvConfig
from tracked_env.entry_points import OURS


def policies(envs: Sequence[str]) -> Iterator[str]:
    """The policies that are registered for these environments, and for any."""
    registered = registered_policies()
    width = max((len(policy.name) for policy in registered), default=0)
    for env, title in [(env, env) for env in envs] + [(None, "any environment")]:
        here = [policy for policy in registered if policy.env == env]
        if here:
            yield title
        for policy in here:
            origin = "" if policy.distribution == OURS else f"  [{policy.distribution}]"
            yield f"  {policy.name:<{width}}  {policy.summary}{origin}"


def environments(envs: Sequence[str]) -> Iterator[str]:
    """The environments with their drive, vehicle and plant, and their evaluation sets."""
    for env in envs:
        of = {**EnvConfig._field_defaults, **gymnasium.spec(env).kwargs}
        yield (
            f"{env}  actions: sprocket {of['drive']}s; vehicle {of['vehicle']}; "
            f"{of['plant']} plant; sensors {of['sensors']}"
        )
        marks = dict(_marks(env))
        sets = [each.name for each in SETS.values() if each.env == env]
        width = max(map(len, sets), default=0)
        for each in (SETS[name] for name in dict.fromkeys((*default_sets(env), *sets))):
            sensors = each.sensors if isinstance(each.sensors, str) else dict(each.sensors)
            mark = marks.get(each.name, "not by default")
            yield f"  {each.name:<{width}}  {each.uncertainty}, sensors {sensors}  [{mark}]"


def _marks(env: str) -> Iterator[tuple[str, str]]:
    """Of each set in groups, what is said of it: the default version is said last."""
    newest = version_of(env)
    versions = [version for version in VERSIONS.values() if version.groups and env in version.envs]
    for version in sorted(versions, key=lambda version: version is newest):
        for name, entry in frozen.stored(version)["sets"].items():
            group, digest = group_of(name, version), entry["hash"]
            usual = "" if version is newest else ", not by default"
            mark = f"{version.name}, {group}, version {SETS[name].version}, hash {digest}{usual}"
            yield name, mark


def main(arguments: Sequence[str], program: str) -> int:
    """Either command; returns the exit status."""
    lists_policies = program.endswith("policies")
    text = "List the environments and their evaluation sets."
    if lists_policies:
        text = "List the policies that are registered, with all their seeds."
    parser = Parser(program, text)
    add_env(parser, text="of this environment alone", default=None)
    chosen = parser.parse_args(arguments).env
    envs = ENVIRONMENTS if chosen is None else (chosen,)
    print("\n".join(policies(envs) if lists_policies else environments(envs)))
    return 0
