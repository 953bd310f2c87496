"""`tracked-env export`: the network of a trained agent as a file for a robot.

What writes it is the function that an installed package registers as `export` in
`tracked_env.commands`: (archive, file, name of the agent) -> metadata.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from tracked_env import TORQUE_ID
from tracked_env.benchmark.policies import (
    archives,
    by_name,
    command_function,
    own_name,
    registered_policies,
)
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import add_env

ARCHIVE = "agent.zip"  # in the folder of a training


def archive_of(spec: str, env: str) -> Path:
    """The archive that an item of the command line names; of several seeds the first one.

    Raises ValueError for what is no trained agent.
    """
    known = by_name(registered_policies(), env)
    spec = str(Path(spec, ARCHIVE)) if Path(spec).is_dir() else spec
    found = archives(spec, known)
    if not found:
        agents = ", ".join(name for name, one in known.items() if isinstance(one, list))
        raise ValueError(
            f"{spec!r} is no trained agent; must be one of {agents}, an archive of train.py, or "
            "its folder. A controller has no network"
        )
    return found[0][1]


def main(arguments: Sequence[str], program: str) -> int:
    """Export; returns the exit status."""
    parser = Parser(
        program,
        "Write the network of a trained agent as a file that onnxruntime runs: scaling, limits "
        "and memory are in it, names and units in its metadata. Needs the extra `export`.",
    )
    text = "NAME or NAME@SEED of a trained agent (`tracked-env policies`), agent.zip, or its folder"
    parser.add_argument("agent", metavar="AGENT", help=f"{text}; of several seeds the first one")
    add_env(parser, text="environment of the agent that is named (default: Torque-v0)")
    text = "format of the file (default: onnx)"
    parser.add_argument("--format", choices=("onnx",), default="onnx", help=text)
    text = "file to write (default: NAME-seedSEED.onnx, after the folder of the agent)"
    parser.add_argument("--file", type=Path, metavar="FILE", help=text)
    options = parser.parse_args(arguments)
    archive = archive_of(options.agent, options.env or TORQUE_ID)
    file = options.file or Path(f"{own_name(archive)}.{options.format}")
    metadata = command_function("export")(archive, file, own_name(archive))
    fields, features = (len(json.loads(metadata[key])) for key in ("observation", "features"))
    rate = f"{metadata['control_rate']} Hz"
    print(f"{file}: {fields} fields of the observation, {features} features, {rate}")
    print(f"action: {metadata['action']}")
    return 0
