"""Colours, markers and type of all figures; how estimates are told apart, names of axes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from pilotid.estimate.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType


#: What matplotlib takes for the stroke of a line.
Dash = Literal["-", "--"] | tuple[float, tuple[float, ...]]


class Style(NamedTuple):
    """Colour, marker and stroke of a method."""

    colour: str
    marker: str
    dash: Dash = "-"


# Colours that people with a colour vision deficiency tell apart (after Okabe and Ito, 2008, and
# Tol, 2021; darker where they had no contrast of 3 to 1 with white, as WCAG 2.2 asks), and
# markers and strokes, so that methods differ without colour, too: the same in every figure.
STYLES = {
    "mle": Style("#0072B2", "^", "-"),
    "mle-reference": Style("#6A5F00", "h", (0, (9.0, 1.5, 3.0, 1.5))),
    "fourier": Style("#009E73", "D", (0, (5.0, 1.5))),
    "arx": Style("#CC8400", "v", (0, (4.0, 1.2, 1.0, 1.2))),
    "bayes": Style("#332288", "<", (0, (1.2, 1.0))),
    "mle-white": Style("#D55E00", "s", (0, (7.0, 2.0))),
    "sindy": Style("#CC79A7", "X", (0, (3.0, 1.0, 1.0, 1.0, 1.0, 1.0))),
    "mle-genetic": Style("#3D9AD1", "P", (0, (2.5, 2.5))),
    "bayes-white": Style("#882255", ">", (0, (1.0, 2.5))),
    "mmle3": Style("#929292", "o", (0, (8.0, 1.5, 1.5, 1.5))),
}
#: Of methods from other packages.
OTHERS = (Style("#117733", "*"), Style("#AA4499", "p"), Style("#3FA294", "1"))
WIDTH = 7.6  # inches, two columns of a journal
SMALLEST = 7.5  # points, the smallest type of a figure: above 7 once an A4 page holds it
INK = "#333333"
GRID = "#dddddd"
#: Small type, thin axes: matplotlib's settings for a figure in a column of a journal.
JOURNAL: dict[RcKeyType, Any] = {
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
    "lines.linewidth": 1.0,
}


def style_of(method: str) -> Style:
    """The style of a method; a study's name may stand behind it after a comma."""
    name = method.partition(", ")[0]
    return STYLES.get(name, OTHERS[sum(map(ord, method)) % len(OTHERS)])


@contextmanager
def journal_figure(
    height: float, layout: Literal["constrained"] | None = "constrained"
) -> Iterator[Figure]:
    """A figure two columns wide and so high [in], in the style of a journal while it is drawn."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(JOURNAL):
        yield Figure(figsize=(WIDTH, height), layout=layout)


def draw_grid(axes: Axes, which: Literal["both", "x", "y"] = "both") -> None:
    """A faint grid behind all that is drawn."""
    axes.grid(axis=which, color=GRID, linewidth=0.5)
    axes.set_axisbelow(True)


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


class Named(NamedTuple):
    """One estimate of a plot, with its label and how it looks."""

    estimate: Estimate
    label: str
    style: Style

    @property
    def known(self) -> bool:
        """Whether the estimate has values."""
        return bool(np.isfinite(self.estimate.values).all())


def named(estimates: Sequence[Estimate]) -> list[Named]:
    """Estimates by method or, if these repeat, by model and number; one alone has a full line."""
    pairs = [(e.method, e.model.name) for e in estimates]
    methods, models = {method for method, _ in pairs}, {model for _, model in pairs}
    styled = []
    for number, (estimate, (method, model)) in enumerate(zip(estimates, pairs, strict=True)):
        alike = len(methods) < len(estimates)
        look = [*STYLES.values()][number % len(STYLES)] if alike else style_of(method)
        label = f"{method}, {model}" if len(models) > 1 else method
        if pairs.count((method, model)) > 1:
            label += f" {pairs[: number + 1].count((method, model))}"
        alone = len(estimates) == 1
        styled.append(Named(estimate, label, look._replace(dash="-") if alone else look))
    return styled


def leading(estimates: Sequence[Estimate]) -> Estimate | None:
    """The estimate to show where there is room for one; None if none has values.

    Of the usable ones the first with a model of the remnant, else the first.
    """
    known = [e for e in estimates if np.isfinite(e.values).all()]
    usable = [e for e in known if e.outcome.usable] or known
    return next((e for e in usable if e.remnant is not None), usable[0] if usable else None)


def legend(axes: Axes, **where: Any) -> None:
    """A legend, if anything has a name."""
    if axes.get_legend_handles_labels()[1]:
        axes.legend(frameon=False, **where)


def with_unit(what: str, unit: str) -> str:
    """The label of an axis."""
    return f"{what} [{unit}]" if unit else what


def ratio_unit(units: Mapping[str, str], signal: str) -> str:
    """Unit of the control over that of a channel's input; empty if one of them is unknown."""
    above, below = units.get("u", ""), units.get(signal, "")
    if not (above and below):
        return ""
    return "-" if above == below else f"{_whole(above)}/{_whole(below)}"


def square_unit(units: Mapping[str, str], signal: str) -> str:
    """The square of a signal's unit, or of the signal where its unit is unknown."""
    return f"{_whole(units.get(signal, '') or signal)}²"


def _whole(unit: str) -> str:
    return f"({unit})" if "/" in unit or " " in unit else unit


def new_axes() -> Axes:
    """Axes of a new figure, which pyplot shows and keeps."""
    from matplotlib import pyplot

    return pyplot.subplots(figsize=(WIDTH, 3.0), layout="constrained")[1]


def new_columns(count: int) -> list[Axes]:
    """Axes of magnitude and phase, so many columns in turn, in a new figure by pyplot."""
    from matplotlib import pyplot

    _, axes = pyplot.subplots(
        *(2, count), sharex=True, height_ratios=(3, 2), squeeze=False,
        figsize=(2.0 + 4.0 * count, 5.0), layout="constrained",
    )  # fmt: skip
    return [*axes.T.ravel()]
