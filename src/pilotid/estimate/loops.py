"""Crossover frequencies and phase margins of the loops that an estimate makes with an element.

Their errors are those of the pilot's parameters, by the posterior where there is one and else to
first order; the controlled element is taken as known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pilotid.checks.checks import motionless
from pilotid.checks.element_fit import closing_element
from pilotid.estimate.quantities import Draws, Quantity, normal, sampled, spans_decade
from pilotid.model.element import ControlledElement
from pilotid.model.loops import (
    GRID,
    Margin,
    are_stable,
    crossings,
    is_stable,
    loop_slopes,
    margin,
    open_loops,
)
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.support.limits import ESTIMATE, SIGNAL
from pilotid.support.remarks import Remark, remarks_json
from pilotid.support.types import BoolArray, ComplexArray, FloatArray

NAMES = ("target", "disturbance")
UNITS = {"crossover": "rad/s", "phase_margin": "deg", "effective_delay": "s"}
COARSE = GRID[:: len(GRID) // 1000]  # for many sets of parameters
COUNT = 1000  # draws of a posterior
NO_CROSSING = (
    f"no crossing: the magnitude does not fall through one between {GRID[0]:g} and {GRID[-1]:g} "
    "rad/s"
)
NEAREST_RATIO = 2.0  # times the estimate's crossover; other crossings lie further off


def loops_of(
    model: PilotModel,
    values: FloatArray,
    covariance: FloatArray,
    draws: Draws | None,
    element: ControlledElement,
) -> Loops:
    """The loops that an estimate makes with a controlled element, with errors.

    Parameters
    ----------
    model, values, covariance, draws
        The estimate's; of one that failed every number is NaN.
    element
        The controlled element.
    """
    is_known = bool(np.isfinite(values).all())
    if why := model.no_loop if is_known else "the fit failed":
        return Loops(element, no_loop("target", why), no_loop("disturbance", why))
    sets = None if draws is None else draws.thinned(COUNT)[:, : len(model.parameters)]
    target, disturbance = both_loops(model, values, element, covariance, sets)
    if is_stable(model, values, element):
        return Loops(element, target, disturbance)
    remark = Remark(
        "misspecified",
        f"the fitted loop with {element.name or 'this element'} is unstable, though the recorded "
        "one was not: the model, the controlled element or a sign is wrong, or the estimate is "
        "poor; do not use its margins",
    )
    return Loops(element, target, disturbance, (remark,))


def both_loops(
    model: PilotModel,
    values: FloatArray,
    element: ControlledElement,
    covariance: FloatArray,
    sets: FloatArray | None = None,
) -> list[Loop]:
    """Target and disturbance loop, with errors over draws or else to first order.

    Parameters
    ----------
    model, values, element
        What the loops are made of.
    covariance
        Of the values.
    sets
        Draws of the values, shape (sets, parameters).
    """
    every = None if sets is None else [open_loops(model, draw, element, COARSE) for draw in sets]
    loops = []
    for i, loop in enumerate(open_loops(model, values, element, GRID)):
        at = margin(GRID, loop)
        if math.isnan(at.crossover):
            loops.append(no_loop(NAMES[i], NO_CROSSING))
        elif every is None:
            slopes = margin_slopes(model, values, element, at.crossover)[i]
            loops.append(_by_delta(NAMES[i], at, slopes, covariance))
        else:
            loops.append(_by_draws(NAMES[i], at, [both[i] for both in every]))
    return loops


def stabilised_element(
    recording: Recording, model: PilotModel, values: FloatArray
) -> ControlledElement | None:
    """The element that closes the loop of a recording, if it is known and a pilot keeps it stable.

    Parameters
    ----------
    recording
        The recording.
    model, values
        The pilot, with parameters in model order, shape (parameters,).
    """
    element = closing_element(recording)
    return element if element and is_stable(model, values, element) else None


def are_pilots(recording: Recording, model: PilotModel, sets: FloatArray) -> BoolArray:
    """Which parameters can be those of a pilot, as the recorded loop was stable; shape (sets,).

    All can be where no controlled element is known or the model has no loop.
    """
    element = None if model.no_loop else closing_element(recording)
    return np.ones(len(sets), dtype=bool) if element is None else are_stable(model, sets, element)


# ------------------------------------------------------------------ to first order


def _by_delta(name: str, at: Margin, slopes: FloatArray, covariance: FloatArray) -> Loop:
    """A loop from the derivatives of its crossover and its phase margin."""
    delay = float(effective_delay(at.crossover, at.phase_margin))
    by_delay = -(delay * slopes[0] + np.radians(slopes[1])) / at.crossover
    slopes = np.vstack([slopes, by_delay])
    errors = np.sqrt(np.einsum("qi,ij,qj->q", slopes, covariance, slopes)).tolist()
    numbers = zip((at.crossover, at.phase_margin, delay), errors, strict=True)
    return _loop(name, numbers, normal, at.others)


def effective_delay(crossover: FloatArray | float, phase_margin: FloatArray | float) -> FloatArray:
    """The delay [s] of the crossover model, wc/s e^(-delay s), with this margin [deg].

    Source: McRuer & Jex, *IEEE Trans. Human Factors in Electronics* HFE-8(3), 1967.
    """
    return np.asarray(np.radians(90.0 - np.asarray(phase_margin)) / crossover)


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
        with np.errstate(invalid="ignore"):  # a loop that is nil has no slope
            by_omega = np.log(loop[2] / loop[0]) / (omega[2] - omega[0])
        by_values = slope[:, 1]
        moved = -by_values.real / by_omega.real
        result.append([moved, np.degrees(by_values.imag + by_omega.imag * moved)])
    return np.array(result)


# ------------------------------------------------------------------ over draws


def _by_draws(name: str, at: Margin, loops: Sequence[ComplexArray]) -> Loop:
    """A loop from the same of every draw.

    A loop may have several crossings; of each draw the one nearest to that of the estimate counts,
    and its phase margin is continuous about the estimate's.
    """
    nearest = [_nearest(loop, at.crossover) for loop in loops]
    kept = np.array([pair for pair in nearest if pair], dtype=float).reshape(-1, 2)
    lost, remark = 1.0 - len(kept) / len(loops), ""
    if lost > ESTIMATE.lost_crossing:
        remark = (
            f"in {100.0 * lost:.0f} % of the draws its magnitude does not fall through one "
            f"near {at.crossover:.3g} rad/s; they are left out"
        )
    if not len(kept):
        return no_loop(name, remark, at.others)
    frequency, phase = kept.T
    phase = phase + 360.0 * np.round((at.phase_margin - phase) / 360.0)
    draws = [(q,) for q in (frequency, phase, effective_delay(frequency, phase))]
    return _loop(name, draws, sampled, at.others, remark)


def _nearest(loop: ComplexArray, start: float) -> tuple[float, float] | None:
    """Frequency and phase margin of the crossing nearest to `start`; None if none is near."""
    frequency, phase_margin = crossings(COARSE, loop)
    away = np.abs(np.log(frequency / start))
    near = away <= np.log(NEAREST_RATIO)
    if not near.any():
        return None
    i = int(np.argmin(away))
    return float(frequency[i]), float(phase_margin[i])


@dataclass(frozen=True, eq=False)
class Loop:
    """One open loop of an estimate.

    Attributes
    ----------
    name
        ``target`` or ``disturbance``.
    crossover, phase_margin, effective_delay
        NaN where there is none; the delay is that of the crossover model with this margin.
    others
        Further frequencies where the magnitude falls through one [rad/s].
    remark
        Why there is no crossover, or what else should be known; empty if nothing should.
    """

    name: str
    crossover: Quantity
    phase_margin: Quantity
    effective_delay: Quantity
    others: tuple[float, ...] = ()
    remark: str = ""

    @property
    def notes(self) -> list[str]:
        """What should be known of it, a sentence each."""
        sentences = [f"{self.name} loop: {self.remark}"] if self.remark else []
        if self.others:
            where = ", ".join(f"{w:.3g}" for w in self.others)
            sentences.append(f"the {self.name} loop falls through one again at {where} rad/s")
        return sentences

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        numbers = {what: getattr(self, what).to_dict() for what in UNITS}
        return {**numbers, "others": list(self.others), "remark": self.remark}


@dataclass(frozen=True, eq=False)
class Loops:
    """Both open loops of an estimate with a controlled element.

    Attributes
    ----------
    element
        The controlled element.
    target, disturbance
        The loops, see `pilotid.model.loops`.
    remarks
        What speaks against them, a sentence each.
    excited
        The names of those that a forcing function excites; only these are shown.
    """

    element: ControlledElement
    target: Loop
    disturbance: Loop
    remarks: tuple[str, ...] = ()
    excited: tuple[str, ...] = NAMES

    @property
    def shown(self) -> list[Loop]:
        """The loops that the recording excites."""
        return [lp for lp in (self.target, self.disturbance) if lp.name in self.excited]

    @property
    def quantities(self) -> list[Quantity]:
        """Crossover frequency and phase margin of the target, then of the disturbance loop."""
        return [q for loop in self.shown for q in (loop.crossover, loop.phase_margin)]

    @property
    def notes(self) -> list[str]:
        """What should be known of the margins, a sentence each."""
        return [note for loop in self.shown for note in loop.notes]

    def excited_by(self, recording: Recording) -> Loops:
        """The same, with no numbers for a loop that no forcing function of a recording excites."""
        target = recording.window(recording.input("ft"))
        moves = {
            "target": bool(np.std(target) > SIGNAL.still * np.std(recording.window(recording.e))),
            "disturbance": recording.fd is not None and not motionless(recording, "fd"),
        }
        absent = {name: no_loop(name, f"no {name} excites it") for name in NAMES if not moves[name]}
        excited = tuple(name for name in NAMES if moves[name])
        return replace(self, excited=excited, **absent)  # type: ignore[arg-type]

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them; NaN where there is none."""
        return {
            "element": self.element.name,
            "target": self.target.to_dict(),
            "disturbance": self.disturbance.to_dict(),
            **remarks_json(self.remarks),
        }


def no_loop(name: str, why: str, others: tuple[float, ...] = ()) -> Loop:
    """A loop without a crossover, and why."""
    return _loop(name, [(math.nan, math.nan)] * 3, normal, others, why)


def _loop(
    name: str,
    numbers: Iterable[tuple[Any, ...]],
    quantity: Callable[..., Quantity],
    others: tuple[float, ...],
    remark: str = "",
) -> Loop:
    """A loop of the numbers that a quantity is made of, in the order of `UNITS`."""
    named = zip(UNITS.items(), numbers, strict=True)
    three = [quantity(f"{name}_{what}", unit, *given) for (what, unit), given in named]
    three[0] = replace(three[0], lower=max(three[0].lower, 0.0))
    low, high = three[0].interval
    known = bool(low > 0.0 and not spans_decade(low, high))
    crossover, phase_margin, late = (replace(q, determined=known) for q in three)
    return Loop(name, crossover, phase_margin, late, others, remark)
