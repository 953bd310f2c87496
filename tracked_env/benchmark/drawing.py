"""Common parts of all figures of the benchmark: colours, sizes, title and legend.

Colours are those of Okabe and Ito, distinguishable with any colour vision; every policy has a
line style and a marker of its own as well.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

PALETTE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe-Ito
LINE_STYLES = ("--", "-", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
MARKERS = ("v", "o", "s", "D", "^", "P")
REFERENCE_COLOUR = "0.55"
DPI = 120  # [1/inch]
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "legend.frameon": False,
}


class Look(NamedTuple):
    """How one policy is drawn."""

    colour: str
    line_style: Any
    marker: str


def looks(policies: Sequence[str]) -> dict[str, Look]:
    """Line style of each policy, the same in every figure; 36 different ones."""
    return {
        name: Look(PALETTE[i % 6], LINE_STYLES[(i + i // 6) % 6], MARKERS[(i + i // 6) % 6])
        for i, name in enumerate(policies)
    }


def new_figure(
    panel: tuple[float, float],
    rows: int = 1,
    columns: int = 1,
    left: float = 0.65,
    gap: tuple[float, float] = (0.35, 0.4),
    **shared: Any,
) -> Any:
    """Figure and axes (rows, columns), without any global state.

    panel, gap: width and height of a panel and between two [inch]; left: left margin [inch].
    Fixed margins, because measuring the labels takes longer than drawing the figure.
    """
    from matplotlib.figure import Figure

    right, top, bottom = 0.15, 0.9, 0.55
    width = left + columns * panel[0] + (columns - 1) * gap[0] + right
    height = bottom + rows * panel[1] + (rows - 1) * gap[1] + top
    figure = Figure(figsize=(width, height), dpi=DPI)
    grid = {
        "left": left / width,
        "right": 1.0 - right / width,
        "wspace": gap[0] / panel[0],
        "bottom": bottom / height,
        "top": 1.0 - top / height,
        "hspace": gap[1] / panel[1],
    }
    return figure, figure.subplots(rows, columns, squeeze=False, gridspec_kw=grid, **shared)


def plain_ticks(axis: "Axis", places: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Ticks of a logarithmic axis at these places of each decade, written as plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=places))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def head(figure: "Figure", axes: "Axes", title: str, style: dict[str, Look]) -> None:
    """Title at the upper left, and below it one legend for all panels."""
    width, height = figure.get_size_inches()
    handles, labels = axes.get_legend_handles_labels()
    by_label = dict(zip(labels, handles, strict=True))
    order = [label for label in ("reference", "true", *style) if label in by_label]
    figure.legend(
        [by_label[label] for label in order],
        order,
        loc="upper left",
        bbox_to_anchor=(0.0, 1.0 - 0.3 / height),
        ncols=len(labels),
    )
    figure.suptitle(title, x=0.12 / width, y=1.0 - 0.12 / height, ha="left", va="top", fontsize=11)


Traces = dict[str, dict[str, NDArray[Any]]]  # of one set, by policy
