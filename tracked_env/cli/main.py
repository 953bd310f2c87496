"""`tracked-env COMMAND ...`: compare, list and draw policies; plan motions; train from a clone.

Each command is a function(arguments, program) -> exit status, by default `main`, of a module that
is imported when it is run, or such a function that an installed package registers in the entry
point group `tracked_env.commands`.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from tracked_env.cli.command_line import Parser, end_at_interrupt, reported

COMMANDS = {
    "evaluate": ("evaluate_command", "compare policies on the same randomized episodes"),
    "leaderboard": (
        "evaluate_command:leaderboard_main",
        "evaluate everything that is registered, and rank it",
    ),
    "compile": ("compile_command", "compile kernels ahead of first calls, on all processors"),
    "policies": ("evaluate_options:list_main", "list the policies that are registered"),
    "envs": ("evaluate_options:list_main", "list the environments and their evaluation sets"),
    "render": ("episode_commands:render_main", "write a film or picture of a policy"),
    "drive": (
        "episode_commands:drive_main",
        "drive by keyboard, with an observer's estimates beside",
    ),
    "plan": ("vehicle_commands:plan_main", "plan a motion to a goal with slip, print and draw it"),
    "vehicle": (
        "vehicle_commands:vehicle_main",
        "what a vehicle can do, by its name or from your file",
    ),
    "timing": (
        "policy_commands:timing_main",
        "time of a call of a policy, as a robot's loop would make it",
    ),
    "tune": (
        "policy_commands:tune_main",
        "search the settings of a controller on development episodes",
    ),
    "record": ("episode_commands:record_main", "drive an episode and write the log of its sensors"),
    "identify": ("", "mass, inertia, resistance, slip, soil from your own log"),
    "slip": ("", "slip over the sprocket speeds, from your own runs"),
    "export": (
        "policy_commands:export_main",
        "write the network of a trained agent as ONNX, for a robot",
    ),
    "train": ("command_line:train_main", "train an agent; needs a clone of the repository"),
}


@reported
def _run(arguments: Sequence[str], program: str) -> int:
    """Run a command of this package or of an installed one."""
    name = program.split()[-1]
    module, _, function = COMMANDS[name][0].partition(":")
    if module:
        run = getattr(import_module(f"tracked_env.cli.{module}"), function or "main")
    else:
        from tracked_env.benchmark.policies import command_function

        run = command_function(name)
    status: int = run(arguments, program)
    return status


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    width = max(map(len, COMMANDS))
    parser = Parser(
        "tracked-env",
        "Benchmark of policies for tracked vehicles on unknown soil.",
        epilog="\n".join(f"  {name:<{width}}  {text}" for name, (_, text) in COMMANDS.items())
        + "\n\n`tracked-env COMMAND --help` lists the options of a command.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("command", choices=COMMANDS, metavar="COMMAND", help="one of those below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="of the command")
    words = sys.argv[1:] if arguments is None else arguments
    if not words:
        parser.print_help(sys.stderr)
        return 2
    options = parser.parse_args(words)
    program = f"tracked-env {options.command}"
    end_at_interrupt(program)
    sys.path.insert(0, "")  # so that `module:attribute` finds modules of the current folder
    try:
        status = _run(options.arguments, program)
        sys.stdout.flush()
    except BrokenPipeError:  # as `tracked-env policies | head` has it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # as shells have it for a closed pipe
    return status


if __name__ == "__main__":
    sys.exit(main())
