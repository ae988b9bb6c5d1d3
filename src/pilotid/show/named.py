"""How the estimates of a plot are told apart, and what its axes are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.recordings.recording import INPUTS
from pilotid.show.style import DASHES, STYLES, Dash, dash_of, style_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Named:
    """One estimate of a plot, with its label, colour, marker and stroke."""

    estimate: Estimate
    label: str
    colour: str
    marker: str
    dash: Dash

    @property
    def known(self) -> bool:
        """Whether the estimate has values."""
        return bool(np.isfinite(self.estimate.values).all())


def named(estimates: Sequence[Estimate]) -> list[Named]:
    """Estimates by method or, if these repeat, by model and number; one alone has a full line."""
    methods, models = [e.method for e in estimates], [e.model.name for e in estimates]
    alike = len(set(methods)) < len(methods)
    pairs = list(zip(methods, models, strict=True))
    found = []
    for number, (estimate, (method, model)) in enumerate(zip(estimates, pairs, strict=True)):
        style, dash = style_of(method), dash_of(method)
        if len(estimates) == 1:
            dash = "-"
        if alike:
            style = list(STYLES.values())[-number % len(STYLES)]
            dash = list(DASHES.values())[number % len(DASHES)]
        label = f"{method}, {model}" if len(set(models)) > 1 else method
        if pairs.count((method, model)) > 1:
            label += f" {pairs[: number + 1].count((method, model))}"
        found.append(Named(estimate, label, *style, dash))
    return found


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


def ratio_unit(units: Mapping[str, str], channel_input: str) -> str:
    """Unit of the control over that of a channel's input; empty if one of them is unknown."""
    above, below = units.get("u", ""), units.get(INPUTS[channel_input], "")
    if not (above and below):
        return ""
    return "-" if above == below else f"{_whole(above)}/{_whole(below)}"


def square_unit(units: Mapping[str, str], signal: str) -> str:
    """The square of a signal's unit, or of the signal where its unit is unknown."""
    return f"{_whole(units.get(signal, '') or signal)}²"


def _whole(unit: str) -> str:
    return f"({unit})" if "/" in unit or " " in unit else unit


def new_axes(height: float = 3.0, width: float = 7.6) -> Axes:
    """Axes of a new figure, which pyplot shows and keeps."""
    from matplotlib import pyplot

    return pyplot.subplots(figsize=(width, height), layout="constrained")[1]


def new_pair() -> tuple[Axes, Axes]:
    """Axes of magnitude and phase in a new figure by pyplot."""
    from matplotlib import pyplot

    _, (above, below) = pyplot.subplots(
        2, 1, sharex=True, height_ratios=(3, 2), figsize=(6.0, 5.0), layout="constrained"
    )
    return above, below
