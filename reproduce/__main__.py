"""`python -m reproduce PAPER`: run the experiments of a paper, as `evaluate.py --paper` does."""

import argparse
import sys
from pathlib import Path

from reproduce.paper_page import PAPERS, main

DESCRIPTION = "Run the experiments of a paper and print its claims beside what comes out."

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m reproduce", description=DESCRIPTION)
    parser.add_argument("paper", choices=PAPERS, help="the paper whose experiments are run")
    parser.add_argument("--output", type=Path, default=Path("results"), metavar="FOLDER",
                        help="the page goes to FOLDER/PAPER (default: %(default)s)")  # fmt: skip
    parser.add_argument(
        "--no-figures", dest="figures", action="store_false", help="write the page without figures"
    )
    arguments = parser.parse_args()
    sys.exit(main(arguments.paper, arguments.output, arguments.figures))
