"""Colours, markers and type of all figures."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: What matplotlib takes for the stroke of a line.
Dash = Literal["-", "--"] | tuple[float, tuple[float, ...]]

# Colours that people with a colour vision deficiency tell apart (after Okabe and Ito, 2008, and
# Tol, 2021; darker where they had no contrast of 3 to 1 with white, as WCAG 2.2 asks), and
# markers, so that methods differ without colour, too: the same in every figure.
STYLES: dict[str, tuple[str, str]] = {
    "mmle3": ("#929292", "o"),
    "mle-white": ("#D55E00", "s"),
    "mle-genetic": ("#3D9AD1", "P"),
    "mle": ("#0072B2", "^"),
    "mle-reference": ("#6A5F00", "h"),
    "fourier": ("#009E73", "D"),
    "arx": ("#CC8400", "v"),
    "sindy": ("#CC79A7", "X"),
    "bayes": ("#332288", "<"),
    "bayes-white": ("#882255", ">"),
    "mle-windowed": ("#6394CA", "d"),
    "rarx": ("#AA4466", "H"),
    "ukf": ("#117744", "8"),
}
#: Strokes, so that lines differ in grey, too.
DASHES: dict[str, Dash] = {
    "mle": "-",
    "mle-reference": (0, (9.0, 1.5, 3.0, 1.5)),
    "fourier": (0, (5.0, 1.5)),
    "arx": (0, (4.0, 1.2, 1.0, 1.2)),
    "bayes": (0, (1.2, 1.0)),
    "mle-white": (0, (7.0, 2.0)),
    "sindy": (0, (3.0, 1.0, 1.0, 1.0, 1.0, 1.0)),
    "mle-genetic": (0, (2.5, 2.5)),
    "bayes-white": (0, (1.0, 2.5)),
    "mmle3": (0, (8.0, 1.5, 1.5, 1.5)),
    "mle-windowed": (0, (6.0, 1.0, 1.0, 1.0, 1.0, 1.0)),
    "rarx": (0, (2.0, 1.0, 2.0, 3.0)),
    "ukf": (0, (5.0, 1.0, 2.0, 1.0)),
}
#: Of methods from other packages.
OTHERS = (("#117733", "*"), ("#AA4499", "p"), ("#3FA294", "*"))
WIDTH = 7.6  # inches, two columns of a journal
SMALLEST = 7.5  # points, the smallest type of a figure: above 7 once an A4 page holds it
INK = "#333333"
GRID = "#dddddd"


def style_of(method: str) -> tuple[str, str]:
    """Colour and marker of a method; a study's name may stand behind it after a comma."""
    name = method.partition(", ")[0]
    return STYLES.get(name, OTHERS[sum(map(ord, method)) % len(OTHERS)])


def colour_of(method: str) -> str:
    """The colour of a method."""
    return style_of(method)[0]


def marker_of(method: str) -> str:
    """The marker of a method."""
    return style_of(method)[1]


def dash_of(method: str) -> Dash:
    """The stroke of a method's lines."""
    return DASHES.get(method, "-")


def journal_style() -> AbstractContextManager[None]:
    """Small type, thin axes: a figure for a column of a journal."""
    from matplotlib import rc_context

    return rc_context(
        {
            "font.family": "sans-serif",
            "font.sans-serif": ["DejaVu Sans"],
            "font.size": 8.0,
            "axes.titlesize": 8.5,
            "axes.labelsize": 8.0,
            "xtick.labelsize": SMALLEST,
            "ytick.labelsize": SMALLEST,
            "legend.fontsize": SMALLEST,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.edgecolor": "#777777",
            "axes.linewidth": 0.6,
            "xtick.major.width": 0.6,
            "ytick.major.width": 0.6,
            "xtick.minor.size": 0.0,
            "ytick.minor.size": 0.0,
            "axes.unicode_minus": True,
            "lines.linewidth": 1.0,
        }
    )


def log_ticks(axes: Axes, which: str) -> None:
    """Plain numbers on a logarithmic axis that spans little, and few of them if it spans much.

    Parameters
    ----------
    axes
        The axes, whose limits are set already.
    which
        ``x`` or ``y``.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    decades = math.log10(high / low) if low > 0.0 else 1.0
    steps = ((0.75, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)), (2.2, (1.0, 2.0, 5.0)), (3.5, (1.0, 3.0)))
    subs = next((subs for most, subs in steps if decades < most), (1.0,))
    axis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
