"""`tracked-env policies` and `tracked-env envs`: one line each."""

from collections.abc import Iterator, Sequence

import gymnasium

from tracked_env.benchmark import frozen
from tracked_env.benchmark.evaluation_sets import SETS, VERSIONS, default_sets, group_of, version_of
from tracked_env.benchmark.policies import registered_policies
from tracked_env.cli.evaluate_options import ENVIRONMENTS, add_env
from tracked_env.cli.exit_status import Parser
from tracked_env.engine.env_config import EnvConfig
from tracked_env.entry_points import OURS


def policies(envs: Sequence[str]) -> list[str]:
    """The policies that are registered for these environments, and for any."""
    lines = []
    known = registered_policies()
    width = max((len(policy.name) for policy in known), default=0)
    for env, title in [(env, env) for env in envs] + [(None, "any environment")]:
        found = [policy for policy in known if policy.env == env]
        if not found:
            continue
        lines.append(title)
        for policy in found:
            origin = "" if policy.distribution == OURS else f"  [{policy.distribution}]"
            lines.append(f"  {policy.name:<{width}}  {policy.summary}{origin}")
    return lines


def environments(envs: Sequence[str]) -> list[str]:
    """The environments with their drive, vehicle and plant, and their evaluation sets."""
    lines = []
    for env in envs:
        made = {**EnvConfig._field_defaults, **gymnasium.spec(env).kwargs}
        lines.append(
            f"{env}  actions: sprocket {made['drive']}s; vehicle {made['vehicle']}; "
            f"{made['plant']} plant; sensors {made['sensors']}"
        )
        marks = dict(_marks(env))
        own = [each for each in SETS.values() if each.env == env]
        width = max((len(each.name) for each in own), default=0)
        chosen = dict.fromkeys((*default_sets(env), *(each.name for each in own)))
        for each in (SETS[name] for name in chosen):
            sensors = each.sensors if isinstance(each.sensors, str) else dict(each.sensors)
            mark = marks.get(each.name, "not by default")
            lines.append(f"  {each.name:<{width}}  {each.uncertainty}, sensors {sensors}  [{mark}]")
    return lines


def _marks(env: str) -> Iterator[tuple[str, str]]:
    """Of each set in groups, what is said of it: the default version is said last."""
    newest = version_of(env)
    others = (version for version in VERSIONS.values() if version.groups and env in version.envs)
    for version in sorted(others, key=lambda version: version is newest):
        for name, entry in frozen.kept(version)["sets"].items():
            group, digest = group_of(name, version), entry["hash"]
            asked = "" if version is newest else ", not by default"
            mark = f"{version.name}, {group}, version {SETS[name].version}, hash {digest}{asked}"
            yield name, mark


def main(arguments: Sequence[str], program: str) -> int:
    """Either command; returns the exit status."""
    lists_policies = program.endswith("policies")
    parser = Parser(
        program,
        "List the policies that are registered, with all their seeds."
        if lists_policies
        else "List the environments and their evaluation sets.",
    )
    add_env(parser, text="of this environment alone", default=None)
    chosen = parser.parse_args(arguments).env
    envs = ENVIRONMENTS if chosen is None else (chosen,)
    print("\n".join(policies(envs) if lists_policies else environments(envs)))
    return 0
