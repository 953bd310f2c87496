"""What the figures of both papers share: axes, the reference line, files; needs matplotlib."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import matplotlib
from matplotlib.figure import Figure

from reproduce.paper_page import Figures
from tracked_env.benchmark.drawing import DPI, REFERENCE_COLOUR, STYLE

Drawings = dict[str, tuple[Figure, str]]  # {name: (figure, caption)}
R = TypeVar("R")  # results of all experiments of one paper

REFERENCE: dict[str, Any] = {
    "color": REFERENCE_COLOUR,
    "linewidth": 4.0,
    "alpha": 0.45,
    "label": "reference",
}


def panels(size: tuple[float, float], rows: int, columns: int, **shared: Any) -> tuple[Figure, Any]:
    """A figure of size (width, height) [inch] and its axes (rows, columns).

    shared: further arguments of `Figure.subplots`.
    """
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def save(results: R, folder: Path, paper: str, *draw: Callable[[R], Drawings]) -> Figures:
    """Draw all figures of a paper and write them as PAPER-NAME.png. Returns files and captions."""
    written: Figures = {}
    with matplotlib.rc_context(STYLE):
        for drawings in draw:
            for name, (figure, caption) in drawings(results).items():
                file = folder / f"{paper}-{name}.png"
                figure.savefig(file)
                written[name] = (file, caption)
    return written
