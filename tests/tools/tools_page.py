"""Installs each tool as docs/register.md says, runs its examples, writes the versions.

python tests/tools/tools_page.py [--only TITLE ...] [--folder build/tools] [pip arguments]

A section is an environment (the line `pip install ...`), files (blocks that begin with `# name`)
and examples (Python, and shell lines that begin with `python -m`), which run in order in one
folder. Sections with the same line share an environment. PyTorch is the version of constraints.txt.
docs/tools_tested.json has what ran, with which versions; the table of the page is written from it.

A tool that fails does not stop the others: the table at the end says what failed.
"""

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import venv
from pathlib import Path

from tracked_env.benchmark.files import replace_block

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE, TESTED = ROOT / "docs" / "register.md", ROOT / "docs" / "tools_tested.json"
CLONE = "/path/to/tracked-env"
# Title of a section -> its distribution and the module that tells whether it is installed.
TOOLS = {
    "Stable-Baselines3": ("stable-baselines3", "stable_baselines3"),
    "sb3-contrib": ("sb3-contrib", "sb3_contrib"),
    "rl-zoo3": ("rl_zoo3", "rl_zoo3"),
    "A loop of your own": ("torch", "torch"),
    "TorchRL": ("torchrl", "torchrl"),
    "Tianshou": ("tianshou", "tianshou"),
    "Minari": ("minari", "minari"),
    "RLlib": ("ray", "tree"),  # of its extra; Ray's core has the folder of RLlib too
}
BESIDE = ("gymnasium", "torch", "numpy")  # versions that the table has besides
# The examples are for readers; a small part of their budget shows that they run.
SMALL = {
    r"learn\([\d_]+\)": "learn(64)",
    r"\bepisodes=\d+": "episodes=2",
    r"\bn_steps=\d+": "n_steps=16",
    r"\bn_envs=64": "n_envs=4",
    "= 1_000_000, 64, 128": "= 1024, 8, 64",
    "max_epochs=10": "max_epochs=1",
    "epoch_num_steps=20_000": "epoch_num_steps=512",
    "num_training_envs=16": "num_training_envs=2",
    "learner=4000": "learner=256",
    r"range\(100\)": "range(1)",
    "!!float 1e6": "512",
    r"n_steps: \d+": "n_steps: 64",
}


def sections(text):
    """Text below each heading `## ...` of a page behind its table of versions."""
    _, _, text = text.partition("<!-- versions: end -->")
    parts = re.split(r"^## (.*)$", text, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def installation(section):
    """Arguments of the section's `pip install`."""
    line = re.search(r"^pip install (.*)$", section, re.MULTILINE)
    if line is None:
        raise ValueError(f"the section has no line `pip install`: {section[:60]!r}")
    return shlex.split(line[1])


def examples(section):
    """Files of a section {name: text}, and its commands in order, without the interpreter."""
    for budget, small in SMALL.items():
        section = re.sub(budget, small, section)
    files, commands = dict[str, str](), list[list[str]]()
    blocks = re.findall(r"^```(\w+)\n(.*?)^```", section, re.DOTALL | re.MULTILINE)
    for number, (kind, block) in enumerate(blocks):
        if name := re.match(r"# ([\w.]+)\n", block):
            files[name[1]] = block
        elif kind == "python":
            files[f"example_{number}.py"] = block
            commands.append([f"example_{number}.py"])
        elif kind == "bash":
            for line in block.replace("\\\n", " ").splitlines():
                if line.startswith("python -m "):
                    commands.append(shlex.split(line)[1:])
    return files, commands


def run_section(python, section, folder, timeout=900.0):
    """Run its examples in `folder`. Raises AssertionError with what the first that fails prints."""
    files, commands = examples(section)
    assert commands, "the section has no example"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    environment = {**os.environ, "MINARI_DATASETS_PATH": str(folder / "minari")}
    environment.update(MPLBACKEND="Agg", RAY_USAGE_STATS_ENABLED="0", PYTHONPATH=str(ROOT))
    for command in commands:
        output = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        start = {"cwd": folder, "env": environment, "timeout": timeout}
        process = subprocess.run([python, *command], **start, **output)
        assert process.returncode == 0, f"{' '.join(command)}\n{process.stdout[-4000:]}"


def versions(python, names):
    """Versions of distributions in an environment, and of its Python; absent ones left out."""
    code = (
        "import json, platform, sys\nfrom importlib.metadata import PackageNotFoundError, version\n"
        "found = {'python': platform.python_version()}\n"
        "for name in sys.argv[1:]:\n"
        "    try:\n        found[name] = version(name).partition('+')[0]\n"
        "    except PackageNotFoundError:\n        pass\n"
        "print(json.dumps(found))"
    )
    process = subprocess.run(
        [python, "-c", code, *names], capture_output=True, text=True, check=True
    )
    return dict(json.loads(process.stdout))


def table(tested):
    """The table of the page from what ran."""
    lines = ["| tool | version | Gymnasium | PyTorch | NumPy | Python |", "|--|--|--|--|--|--|"]
    for title, versions_of in tested.items():
        anchor = title.lower().replace(" ", "-")
        version = versions_of.get(TOOLS[title][0], "-") if title in TOOLS else "-"
        cells = [str(versions_of.get(name, "-")) for name in (*BESIDE, "python")]
        lines.append(f"| [{title}](#{anchor}) | {version} | {' | '.join(cells)} |")
    return "\n".join(lines)


def environment_of(arguments, folder, pip):
    """The interpreter of an environment with this installation, made where it is not there.

    Raises CalledProcessError where pip fails, OSError where the folder cannot be written.
    """
    name = re.sub(r"\W+", "-", " ".join(arguments).replace(CLONE, "")).strip("-") or "plain"
    python = folder / name / "bin" / "python"
    if not (folder / name / ".installed").exists():
        venv.create(folder / name, with_pip=True, clear=True)
        constraint, pins = folder / "torch.txt", (ROOT / "constraints.txt").read_text()
        constraint.write_text(re.findall("^torch==.*\n", pins, re.MULTILINE)[0])
        command = [python, "-m", "pip", "install", "-q", *pip, "-c", str(constraint)]
        for argument in arguments:  # this clone in place, so that compiled kernels are shared
            command += ["-e"] if CLONE in argument else []
            command.append(argument.replace(CLONE, str(ROOT)))
        subprocess.run(command, check=True)
        (folder / name / ".installed").touch()
    return python


def run_tool(title, section, folder, pip):
    """(passed, examples failed or not installed; versions) of a tool; an error is printed."""
    try:
        python = environment_of(installation(section), folder, pip)
        run_section(python, section, folder / "runs" / TOOLS[title][1])
        return "passed", versions(python, (TOOLS[title][0], *BESIDE))
    except (AssertionError, subprocess.SubprocessError, OSError) as error:
        print(f"{title}: {error}", flush=True)
        ran = isinstance(error, (AssertionError, subprocess.TimeoutExpired))
        return "examples failed" if ran else "not installed", {}


def main(arguments=None):
    """Run the sections, write the versions of those that ran; status 1 if one failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="*", default=list(TOOLS), metavar="TITLE", choices=TOOLS)
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "tools")
    options, pip = parser.parse_known_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    texts, outcomes = sections(PAGE.read_text()), {}
    tested = json.loads(TESTED.read_text()) if TESTED.exists() else {}
    for title in options.only:
        print(f"{title} ...", flush=True)
        outcomes[title], installed = run_tool(title, texts[title], options.folder.resolve(), pip)
        if installed:
            tested[title] = installed
        elif outcomes[title] == "examples failed":  # then its row no longer tells the truth
            tested.pop(title, None)
        tested = {each: tested[each] for each in TOOLS if each in tested}
        TESTED.write_text(json.dumps(tested, indent=1) + "\n")
    replace_block(PAGE, "versions", table(tested))
    for title, outcome in outcomes.items():
        print(f"{title:<20}  {outcome}")
    return 0 if set(outcomes.values()) == {"passed"} else 1


if __name__ == "__main__":
    sys.exit(main())
