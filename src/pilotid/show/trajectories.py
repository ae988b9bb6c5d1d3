"""Parameters over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.parts import Trajectory
from pilotid.pilot.model import frozen, frozen_over
from pilotid.show.named import leading, named, new_axes, with_unit
from pilotid.show.style import INK
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: How far beyond the values an axis shows a band, in multiples of their span.
BEYOND = 1.5


def trajectory(
    *estimates: Estimate, key: str, truth: FloatArray | None = None, axes: Axes | None = None
) -> Axes:
    """A parameter over time by one or several methods, with the 95 % band of one.

    Parameters
    ----------
    estimates
        Estimates of one model; those without a trajectory are left out.
    key
        The parameter of the constant pilot, such as tlead.
    truth
        True parameters of a simulation, shape (parameters,).
    axes
        Where to draw; None for new axes.

    Returns
    -------
    Axes
    """
    if axes is None:
        axes = new_axes()
    found = [(e, e.trajectory) for e in estimates if e.trajectory is not None]
    chosen = leading([e for e, _ in found])
    reach: list[float] = []
    for (estimate, own), drawn in zip(found, named([e for e, _ in found]), strict=True):
        row = own.keys.index(key)
        colour = drawn.colour
        if estimate is chosen:
            axes.fill_between(
                own.time, own.lower[row], own.upper[row], color=colour, alpha=0.2, linewidth=0
            )
            reach += _shown(own, row)
        axes.plot(own.time, own.values[row], color=colour, linestyle=drawn.dash,
                  label=drawn.label)  # fmt: skip
        known = own.values[row][np.isfinite(own.values[row])]
        reach += np.quantile(known, (0.02, 0.98)).tolist() if known.size else []
    if found and truth is not None:
        model, time = found[0][0].model, found[0][1].time
        true = frozen_over(model.over(float(time[-1])), truth, time)[frozen(model).keys.index(key)]
        axes.plot(time, true, color=INK, linewidth=0.9, linestyle=(0, (3, 2)), label="truth")
        reach += [float(true.min()), float(true.max())]
    if reach and np.ptp(reach) > 0.0:
        room = 0.06 * np.ptp(reach)
        axes.set_ylim(min(reach) - room, max(reach) + room)
    if found:
        unit = next(p.unit for p in frozen(found[0][0].model).parameters if p.key == key)
        axes.set_ylabel(with_unit(key, unit or "-"))
        axes.set_xlim(float(found[0][1].time[0]), float(found[0][1].time[-1]))
    axes.set_xlabel("time [s]")
    return axes


def _shown(own: Trajectory, row: int) -> list[float]:
    """As much of a band as an axis shows: most of it, but not the bounds of what is not known."""
    known = np.isfinite(own.values[row])
    if not known.any():
        return []
    middle = own.values[row][known]
    span = np.ptp(middle) + np.median(own.upper[row][known] - own.lower[row][known])
    low, high = float(own.lower[row][known].min()), float(own.upper[row][known].max())
    return [
        max(low, float(middle.min()) - BEYOND * span),
        min(high, float(middle.max()) + BEYOND * span),
    ]
