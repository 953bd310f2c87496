"""Run the experiments of a paper: progress and claims in the terminal, the page as a file."""

import sys
import time
from importlib import import_module
from pathlib import Path

from reproduce.paper_page import terminal

PAPERS = ("strawa2021", "focchi2025")  # packages beside this file


def main(paper: str, output: Path = Path("results"), figures: bool = True) -> int:
    """Run a paper of PAPERS, print its claims beside what comes out, write OUTPUT/PAPER/page.md.

    figures: draw them; without matplotlib the page has none. Returns the exit status.
    """
    began = time.perf_counter()
    folder = output / paper
    folder.mkdir(parents=True, exist_ok=True)  # before minutes of work: it may be refused

    def say(text: str) -> None:
        print(f"{time.perf_counter() - began:5.0f} s  {text}", flush=True)

    package = import_module(f"reproduce.{paper}")
    results = package.run_everything(say)
    say("page")
    try:
        files = package.PAGE.write(results, folder, figures)
    except ImportError as error:
        print(f"not drawn: {error}", file=sys.stderr)
        files = package.PAGE.write(results, folder, draw=False)
    print(f"\n{terminal(package.PAGE.claims(results))}\n")
    names = ", ".join(file.name for file in files if file.suffix != ".png")
    drawn = sum(file.suffix == ".png" for file in files)
    print(f"{names} and {drawn} figures in {folder}; {time.perf_counter() - began:.0f} s")
    return 0
