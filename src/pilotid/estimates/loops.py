"""Crossover frequencies and phase margins of the loops that an estimate makes with an element.

Their errors are those of the pilot's parameters, by the posterior where there is one and else to
first order; the controlled element is taken as known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.draws import spread_of
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.loop import Loop, Loops, loop_keys, no_loop
from pilotid.estimates.quantities import Quantity, quantity_of
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.loops import (
    GRID,
    Margin,
    crossings,
    loop_slopes,
    margin,
    open_loops,
    unstable_poles,
    why_no_crossing,
)
from pilotid.pilot.model import PilotModel
from pilotid.remarks import Remark
from pilotid.types import ComplexArray, FloatArray

NAMES = ("target", "disturbance")
COARSE = GRID[:: len(GRID) // 1000]  # for many sets of parameters
COUNT = 1000  # draws of a posterior that are followed
NEAR = math.log(1.5)  # how far one crossing moves in one step; others lie further off
STEPS = 4  # from an estimate to a draw whose crossing is not near
CHANGES = (
    "the pilot changes during the recording, and the controlled element, by which pilots change, "
    "most likely too: it has no one loop"
)
LOST = 0.02  # share of draws without the crossing that is worth a word


def loops_of(estimate: Estimate, element: ControlledElement) -> Loops:
    """The loops that an estimate makes with a controlled element, with errors.

    Errors are those of the pilot's parameters: the spread over the draws of a posterior where
    there is one, else to first order from the covariance.  The element is taken as known.

    Parameters
    ----------
    estimate
        Any; of one that failed every number is NaN.
    element
        The controlled element.
    """
    model, values = estimate.model, estimate.values
    if not np.isfinite(values).all():
        target, disturbance = (no_loop(name, "the fit failed") for name in NAMES)
        return Loops(element, target, disturbance)
    if model.changes:
        target, disturbance = (no_loop(name, CHANGES) for name in NAMES)
        return Loops(element, target, disturbance)
    remarks = []
    if unstable_poles(model, values, element):
        remarks.append(
            Remark(
                "unstable-loop",
                f"the fitted loop with {element.name or 'this element'} is unstable, which a "
                "recording cannot be of: the model, the controlled element or a sign is wrong, or "
                "the estimate is poor; its margins mean little",
            )
        )
    if estimate.draws is None:
        target, disturbance = _by_delta(estimate, element)
    else:
        sets = estimate.draws.equally_weighted(COUNT)[:, : len(model.parameters)]
        target, disturbance = (traced.loop for traced in traced_loops(model, values, sets, element))
    return Loops(element, target, disturbance, tuple(remarks))


# ------------------------------------------------------------------ to first order


def _by_delta(estimate: Estimate, element: ControlledElement) -> list[Loop]:
    model, values, covariance = estimate.model, estimate.values, estimate.covariance
    result = []
    for i, (name, loop) in enumerate(
        zip(NAMES, open_loops(model, values, element, GRID), strict=True)
    ):
        found = margin(GRID, loop)
        if math.isnan(found.crossover):
            result.append(no_loop(name, why_no_crossing(GRID, loop)))
            continue
        slopes = margin_slopes(model, values, element, found.crossover)[i]
        errors = np.sqrt(np.einsum("qi,ij,qj->q", slopes, covariance, slopes))
        crossover, phase_margin = (
            Quantity(key, unit, value, error, value - Z95 * error, value + Z95 * error)
            for (key, unit), value, error in zip(
                loop_keys(name), (found.crossover, found.phase_margin), errors.tolist(), strict=True
            )
        )
        result.append(Loop(name, crossover, phase_margin, found.others))
    return result


def margin_slopes(
    model: PilotModel, values: FloatArray, element: ControlledElement, crossover: float
) -> FloatArray:
    """Derivatives of crossover [rad/s] and phase margin [deg] by each parameter.

    Of log L(w, p) = 0 in its real part follows the crossover's, and of its imaginary part along
    with it the phase margin's.

    Parameters
    ----------
    model, values, element
        What the loop is made of.
    crossover
        The loop's crossover frequency [rad/s].

    Returns
    -------
    For the target and the disturbance loop, shape (2, 2, parameters).
    """
    step = 1e-5
    omega = crossover * np.array([1.0 - step, 1.0, 1.0 + step])
    loops = open_loops(model, values, element, omega)
    result = []
    for loop, slope in zip(loops, loop_slopes(model, values, element, omega), strict=True):
        by_omega = np.log(loop[2] / loop[0]) / (omega[2] - omega[0])
        by_values = slope[:, 1]
        moved = -by_values.real / by_omega.real
        result.append([moved, np.degrees(by_values.imag + by_omega.imag * moved)])
    return np.array(result)


# ------------------------------------------------------------------ over draws


@dataclass(frozen=True, eq=False)
class TracedLoop:
    """One crossing of a loop, followed from an estimate to many sets of parameters.

    Attributes
    ----------
    name
        ``target`` or ``disturbance``.
    at
        The estimate's own margin.
    crossover, phase_margin
        Of the sets whose loop has that crossing, shape (kept,); phase margins [deg] are
        continuous about the estimate's.
    remark
        Why there is none, or how many sets lack it; empty if none does.
    """

    name: str
    at: Margin
    crossover: FloatArray
    phase_margin: FloatArray
    remark: str = ""

    @property
    def loop(self) -> Loop:
        """Means, deviations and equal-tailed intervals over the sets."""
        if not self.crossover.size:
            return no_loop(self.name, self.remark, self.at.others)
        crossover, phase_margin = (
            quantity_of(spread_of(key, unit, values))
            for (key, unit), values in zip(
                loop_keys(self.name), (self.crossover, self.phase_margin), strict=True
            )
        )
        return Loop(self.name, crossover, phase_margin, self.at.others, self.remark)


def traced_loops(
    model: PilotModel, centre: FloatArray, sets: FloatArray, element: ControlledElement
) -> list[TracedLoop]:
    """The crossings of an estimate's loops over draws, target first.

    A loop may have several crossings; of each draw the one is taken that the estimate's becomes
    on the way there.

    Parameters
    ----------
    model, element
        What the loops are made of.
    centre
        The estimate, shape (parameters,).
    sets
        Draws, shape (sets, parameters).
    """
    ways = [_Way(model, centre, own, element) for own in sets]
    result = []
    for i, (name, loop) in enumerate(
        zip(NAMES, open_loops(model, centre, element, GRID), strict=True)
    ):
        own = margin(GRID, loop)
        if math.isnan(own.crossover):
            none = np.zeros(0)
            result.append(TracedLoop(name, own, none, none, why_no_crossing(GRID, loop)))
            continue
        pairs = np.array([way.crossing(i, own.crossover) for way in ways])
        kept = pairs[np.isfinite(pairs[:, 0])]
        margins = kept[:, 1] + 360.0 * np.round((own.phase_margin - kept[:, 1]) / 360.0)
        lost = 1.0 - len(kept) / len(pairs)
        remark = (
            f"in {100.0 * lost:.0f} % of the draws its magnitude does not fall through one near "
            f"{own.crossover:.3g} rad/s; they are left out"
            if lost > LOST
            else ""
        )
        result.append(TracedLoop(name, own, kept[:, 0], margins, remark))
    return result


class _Way:
    """From the estimate to one set of parameters."""

    def __init__(
        self, model: PilotModel, centre: FloatArray, own: FloatArray, element: ControlledElement
    ) -> None:
        self.model, self.centre, self.own, self.element = model, centre, own, element
        self.end = self._loops(own)

    def _loops(self, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return open_loops(self.model, values, self.element, COARSE)

    def crossing(self, which: int, start: float) -> tuple[float, float]:
        """Crossover and phase margin of a loop, NaN where the crossing vanishes on the way."""
        near = _nearest(self.end[which], start)
        if math.isfinite(near[0]):
            return near
        for step in range(1, STEPS + 1):
            share = step / STEPS
            values = self.centre + share * (self.own - self.centre)
            near = _nearest(self._loops(values)[which], start)
            start = near[0]
            if not math.isfinite(start):
                break
        return near


def _nearest(loop: ComplexArray, start: float) -> tuple[float, float]:
    frequency, phase_margin = crossings(COARSE, loop)
    if frequency.size:
        away = np.abs(np.log(frequency / start))
        i = int(np.argmin(away))
        if away[i] <= NEAR:
            return float(frequency[i]), float(phase_margin[i])
    return float("nan"), float("nan")
