"""Common parts of all figures of the benchmark: colours, sizes, title and legend.

Colours are those of Okabe and Ito, distinguishable with any colour vision; every policy has a
line style and a marker of its own as well.

A ratio r is coloured by x = ln r / (|ln r| + ln SOFT): blue below 1, red above, white at 1; the
slope is largest at 1, where the leaders differ, and no finite ratio reaches the end of the scale.
"""

import html
import io
import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.statistics import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

PALETTE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe-Ito
LINE_STYLES = ("--", "-", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
MARKERS = ("v", "o", "s", "D", "^", "P")
REFERENCE_COLOUR = "0.55"
DPI = 120  # [1/inch]
MAX_DRAWN = 5  # policies in a figure; more cannot be told apart
SOFT = 1.25  # [-] ratio at half of the colour scale
BLUE, WHITE, RED = (
    np.array(c, dtype=np.float64) for c in ((20, 88, 160), (255,) * 3, (172, 50, 14))
)
MARK_WIDTH = 160.0  # [px] of an interval in a cell
MARK_LIMIT = 8.0  # [-] ratios beyond it, or below its inverse, lie at the end of the mark
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "path.simplify_threshold": 0.3,  # [px] keeps vector files of long episodes small
}


class Look(NamedTuple):
    """How one policy is drawn."""

    colour: str
    line_style: Any
    marker: str


class Mark(NamedTuple):
    """An interval on a logarithmic axis, places in pixels."""

    value: float
    low: float
    high: float
    one: float  # where the ratio is 1


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
    entry = 0.55 + 0.08 * max(map(len, order), default=0)  # [inch] with its handle
    columns = min(max(int(width / entry), 1), max(len(order), 1))
    further = 0.17 * (-(-len(order) // columns) - 1)  # [inch] of the rows after the first
    at = figure.subplotpars
    figure.subplots_adjust(
        bottom=at.bottom * height / (height + further), top=at.top * height / (height + further)
    )
    height += further
    figure.set_size_inches(width, height)
    figure.legend(
        [by_label[label] for label in order],
        order,
        loc="upper left",
        bbox_to_anchor=(0.0, 1.0 - 0.3 / height),
        ncols=columns,
    )
    figure.suptitle(title, x=0.12 / width, y=1.0 - 0.12 / height, ha="left", va="top", fontsize=11)


def svg_text(figure: "Figure", title: str) -> str:
    """A figure as SVG, the same text for the same figure; its letters stay text."""
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title}):
        figure.savefig(
            buffer, format="svg", bbox_inches="tight", pad_inches=0.1,
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )  # fmt: skip
    # A tenth of a point is not seen; the digits behind it are half of a file.
    return re.sub(r' d="[^"]+"', lambda of: re.sub(r"(\.\d)\d+", r"\1", of[0]), buffer.getvalue())


# What a figure inside a page takes over from it: colours of text, grid and background.
_OF_PAGE = {
    "#000000": "currentColor", "#262626": "currentColor", "#e6e6e6": "var(--grid)",
    "#ffffff": "none",
}  # fmt: skip


def inline_svg(text: str, title: str) -> str:
    """An SVG file as an element of HTML; black, white and the grid follow the page's colours."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(?::\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r' id="\w+_\d+"', "", text)  # the same in every figure
    for colour, own in _OF_PAGE.items():
        text = text.replace(colour, own)
    label = html.escape(title, quote=True)
    return text.replace("<svg", f'<svg role="img" aria-label="{label}" fill="currentColor"', 1)


def colour(ratio: float) -> tuple[str, str]:
    """Background and text colour of a ratio of errors."""
    step = math.log(min(max(ratio, 1e-9), 1e9))
    x = step / (abs(step) + math.log(SOFT))
    mixed = (WHITE + abs(x) * ((BLUE if x < 0.0 else RED) - WHITE)).round()
    linear = np.where(mixed <= 10.31, mixed / 3294.6, ((mixed / 255 + 0.055) / 1.055) ** 2.4)
    light = float(linear @ (0.2126, 0.7152, 0.0722))  # relative luminance
    # Contrast is (light + 0.05) / 0.05 with black and 1.05 / (light + 0.05) with white.
    text = "#000" if (light + 0.05) ** 2 > 1.05 * 0.05 else "#fff"
    return "#" + "".join(f"{int(part):02x}" for part in mixed), text


def marks(estimates: Sequence[Estimate]) -> list[Mark]:
    """Intervals of one column on one axis, which holds 1 and ends at MARK_LIMIT at most."""
    low = max(min(1 / 1.1, *(e.low for e in estimates)), 1.0 / MARK_LIMIT)
    high = min(max(1.1, *(e.high for e in estimates)), MARK_LIMIT)
    scale = (MARK_WIDTH - 8.0) / math.log(high / low)

    def place(ratio: float) -> float:
        return round(4.0 + scale * math.log(min(max(ratio, low), high) / low), 1)

    return [Mark(place(e.value), place(e.low), place(e.high), place(1.0)) for e in estimates]


Traces = dict[str, dict[str, NDArray[Any]]]  # of one set, by policy
