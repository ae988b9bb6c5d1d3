"""What a method returns: an outcome, values, their uncertainty, and how it came to them."""

from __future__ import annotations

import enum
import math
from dataclasses import asdict, dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.draws import Draws
from pilotid.estimate.loops import Loops, loops_of
from pilotid.estimate.parts import (
    AnalysedBand,
    FrequencyResponse,
    RemnantEstimate,
    Specification,
    plain_fields,
)
from pilotid.estimate.quantities import (
    Pair,
    Quantity,
    combined,
    frame_of,
    inseparable,
    quantity_tables,
    spans_decade,
)
from pilotid.model.element import ControlledElement, as_element
from pilotid.model.factors import Inverse
from pilotid.model.model import PilotModel
from pilotid.support.format import as_text
from pilotid.support.numbers import Z95
from pilotid.support.remarks import remark_of, remarks_json
from pilotid.support.types import BoolArray, FloatArray, InputError

if TYPE_CHECKING:
    from control import TransferFunction
    from pandas import DataFrame

    from pilotid.likelihood.estimates import Score
    from pilotid.recording.recording import Recording


class Outcome(enum.Enum):
    """How a fit ended; the value is the sentence that tables and reports show."""

    CONVERGED = "converged"
    AT_BOUND = "converged with a parameter at its bound"
    NOT_CONVERGED = "did not converge within the iteration limit"
    NEGATIVE_DELAY = "failed: a time delay was driven negative"
    DIVERGED = "failed: the model's response diverged"
    SINGULAR = "failed: the information matrix is singular"
    UNSTABLE_MODEL = "failed: the first-step model is unusable"
    CONTRADICTED = "failed: the recording contradicts the estimate"
    NOT_APPLICABLE = "not applicable to this recording"
    CRASHED = "failed: an error ended the fit"
    INVALID = "failed: the method returned no sound estimate"
    OUT_OF_MEMORY = "failed: it ran out of memory"
    TIMED_OUT = "failed: it took longer than the time limit"
    DIED = "failed: its process died"

    @property
    def usable(self) -> bool:
        """Whether the estimate counts as a result; all others count as failures."""
        return self in (Outcome.CONVERGED, Outcome.AT_BOUND)

    @property
    def slug(self) -> str:
        """The name in files, for example ``at-bound``."""
        return self.name.lower().replace("_", "-")


@dataclass(frozen=True, eq=False)
class Starts:
    """The record of a search from several starts.

    Attributes
    ----------
    cost
        Final cost of each start over the lowest one, ascending, so that 1 is the best, shape
        (starts,).
    agreeing
        Number of starts that ended in the best optimum.
    """

    cost: FloatArray
    agreeing: int


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """The result of one method on one recording.

    Attributes
    ----------
    method
        Name of the method.
    model
        Model whose parameters were estimated; it fixes their order.
    outcome, message
        How the fit ended, and details if there are any.
    values
        Parameter values, shape (parameters,), NaN where the fit failed.
    covariance
        Claimed covariance of the values, shape (parameters, parameters).
    intervals
        95 % intervals, shape (parameters, 2).
    vaf
        Variance accounted for by the simulated response [%].
    iterations
        Iterations of the optimiser, 0 where it has none.
    starts
        Record of the search, None where there was only one start.
    remnant
        The remnant's spectrum, where the method estimates it.
    frequency_response
        The first step of a two-step method.
    errors
        Standard errors, shape (parameters,), where the method knows them better than the
        covariance tells, which holds near the values only; None where it does not.
    draws
        Draws of the posterior, where the method has one.
    criterion
        What the search made small: -2 log-likelihood up to a constant of the recording, or the
        like; NaN where there is none.
    remarks
        What a user must know before believing it, a sentence each; empty if all is well.
    seconds
        Wall-clock time of the fit.
    band
        The frequencies that it rests on; None if nothing was fitted.
    specification
        Whether it agrees with what another way to estimate says; None where it was not tested.
    """

    method: str
    model: PilotModel
    outcome: Outcome
    values: FloatArray
    covariance: FloatArray
    intervals: FloatArray
    vaf: float = float("nan")
    message: str = ""
    iterations: int = 0
    starts: Starts | None = None
    remnant: RemnantEstimate | None = None
    frequency_response: FrequencyResponse | None = None
    errors: FloatArray | None = None
    draws: Draws | None = None
    remarks: tuple[str, ...] = ()
    criterion: float = float("nan")
    seconds: float = float("nan")
    band: AnalysedBand | None = None
    specification: Specification | None = None

    @property
    def std_error(self) -> FloatArray:
        """Claimed standard errors, shape (parameters,)."""
        if self.errors is not None:
            return self.errors
        return self._curvature

    @property
    def _curvature(self) -> FloatArray:
        """The standard errors that the covariance tells."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> FloatArray:
        """Claimed correlation matrix, shape (parameters, parameters)."""
        return self.covariance / np.outer(self._curvature, self._curvature)

    @property
    def sentence(self) -> str:
        """The outcome in words, with the details."""
        return f"{self.outcome.value} ({self.message})" if self.message else self.outcome.value

    @property
    def parameters(self) -> list[Quantity]:
        """The model's parameters, in model order."""
        numbers = np.column_stack([self.values, self.std_error, self.intervals]).tolist()
        known = self.determined.tolist()
        return [
            Quantity(p.key, p.unit, value, error, low, high, determined)
            for p, (value, error, low, high), determined in zip(
                self.model.parameters, numbers, known, strict=True
            )
        ]

    @property
    def determined(self) -> BoolArray:
        """Which parameters the recording tells, shape (parameters,); see `Quantity`."""
        lower, upper = self.intervals.T
        low, high = at_bounds(self.model, lower, upper)
        decade = self.model.positive & spans_decade(lower, upper)
        return np.asarray(~(low | high | decade) & np.isfinite(self.values))

    @property
    def derived(self) -> list[Quantity]:
        """Products and sums, by the posterior where there is one, else to first order."""
        return combined(self.model.keys, self.values, self.covariance, self.draws)

    @property
    def inseparable(self) -> list[Pair]:
        """Pairs of parameters that the recording cannot tell apart."""
        keys, positive = self.model.keys, self.model.positive
        return inseparable(keys, positive, self.values, self.covariance, self.draws)

    @property
    def quantities(self) -> list[Quantity]:
        """Parameters, and products and sums of them."""
        return [*self.parameters, *self.derived]

    def __getitem__(self, key: str) -> Quantity:
        """A parameter, product or sum by its key: value, standard error, interval and unit."""
        found = {quantity.key: quantity for quantity in self.quantities}
        if key not in found:
            raise KeyError(f"{key}: the estimate has {', '.join(found)}")
        return found[key]

    def verdict(self, *, timed: bool = True) -> str:
        """One line that says how the fit ended, and how well the model describes the control.

        Parameters
        ----------
        timed
            Whether to tell the time it took, which differs from run to run.
        """
        parts = [self.sentence]
        if math.isfinite(self.vaf):
            parts.append(f"VAF {self.vaf:.1f} %")
        if self.starts:
            parts.append(f"{self.starts.agreeing} of {len(self.starts.cost)} starts agree")
        if self.remnant:
            parts.append(self.remnant.words)
        if self.band:
            parts.append(self.band.words)
        if self.frequency_response is not None and self.frequency_response.note:
            parts.append(self.frequency_response.note)
        if timed and math.isfinite(self.seconds):
            parts.append(f"{self.seconds:.2g} s")
        return f"{self.method}: {'; '.join(parts)}"

    def __repr__(self) -> str:
        numbers = ", ".join(f"{q.key} {q.shown()[0]}" for q in self.parameters)
        told = numbers if self.outcome.usable else self.outcome.value
        return f"<Estimate of model {self.model.name} by {self.method}: {told}>"

    def __str__(self) -> str:
        """All quantities, verdict and remarks, as `pilotid fit` prints them."""
        lines = []
        if np.isfinite(self.values).any():
            (table,) = quantity_tables([(self.method, self.quantities)], 1)
            lines += [as_text(table), ""]
        tested = [self.specification.sentence] if self.specification else []
        return "\n".join([*lines, *self.model.held_words, *tested, self.verdict(), *self.remarks])

    def summary(self) -> str:
        """All quantities, the verdict and the remarks, to print; a notebook shows the estimate."""
        return str(self)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    def to_dict(self, *, draws: bool = False) -> dict[str, object]:
        """Plain objects, in the form that `pilotid fit --json` writes; NaN where there is none.

        Parameters
        ----------
        draws
            Whether with the draws of the posterior, which take much room.
        """
        starts, model = self.starts, self.model
        elements = (f.element for c in model.channels for f in c.factors if isinstance(f, Inverse))
        element = next(elements, None)
        result: dict[str, object] = {
            "method": self.method,
            "model": {
                "name": model.name,
                "element": element and asdict(element),
                "bounds": {p.key: [p.lower, p.upper] for p in model.parameters},
            },
            "outcome": self.outcome.slug,
            "message": self.sentence,
            "parameters": {q.key: q.to_dict() for q in self.parameters},
            "derived": {q.key: q.to_dict() for q in self.derived},
            "held": dict(model.held),
            "correlation": self.correlation.tolist(),
            "covariance": self.covariance.tolist(),
            "inseparable": [
                {"parameters": [first, second], "correlation": correlation}
                for first, second, correlation in self.inseparable
            ],
            "vaf": self.vaf,
            "criterion": self.criterion,
            "iterations": self.iterations,
            "starts": starts and {"total": len(starts.cost), **plain_fields(starts)},
            "seconds": self.seconds,
            "band": self.band and self.band.to_dict(),
            "specification": self.specification and self.specification.to_dict(),
            **remarks_json(self.remarks),
            "grades": [remark_of(remark).grade for remark in self.remarks],
        }
        if self.remnant is not None:
            result["remnant"] = self.remnant.to_dict()
        if self.frequency_response is not None:
            names = [channel.name for channel in model.channels]
            result["frequency_response"] = self.frequency_response.to_dict(names)
        if draws and self.draws is not None:
            result["draws"] = plain_fields(self.draws)
        return result

    def table(self) -> DataFrame:
        """A row for each quantity: key, unit, value, standard error and 95 % interval."""
        return frame_of(self.quantities)

    def loops(self, element: ControlledElement | str) -> Loops:
        """Its open loops with a controlled element: ``estimate.loops("15/s^2").quantities``.

        Parameters
        ----------
        element
            The element, or a text for one.
        """
        found = as_element(element)
        return loops_of(self.model, self.values, self.covariance, self.draws, found)

    def simulate(self, recording: Recording) -> DataFrame:
        """The response to the recorded inputs: columns run, time, control and simulated.

        Offset and slow free decays are fitted to each run.

        Parameters
        ----------
        recording
            Any recording that has the model's inputs, not only the one that was fitted.
        """
        from pilotid.likelihood.estimates import simulated

        return simulated(self, recording)

    def predict(self, recording: Recording, fitted_to: Recording | None = None) -> DataFrame:
        """The control predicted one sample ahead: columns run, time, control, predicted and std.

        Samples are those of the band that the remnant is known in; `std` is the standard deviation
        of the prediction error.  The offset is fitted to each run.

        Parameters
        ----------
        recording
            Any recording that has the model's inputs.
        fitted_to
            The recording whose remnant, as the estimate leaves it, predicts; None for the remnant
            that the estimate has itself.

        Raises
        ------
        InputError
            If no remnant is known.
        """
        from pilotid.likelihood.estimates import predicted

        return predicted(self, recording, fitted_to)

    def score(self, recording: Recording, fitted_to: Recording | None = None) -> Score:
        """How well it predicts a recording: ``vaf`` [%] of `simulate`, ``log_score`` of `predict`.

        Parameters
        ----------
        recording, fitted_to
            As for `predict`; without a remnant the log score is NaN.  Methods are compared by log
            scores with `fitted_to`, where the remnant is modelled alike for all.
        """
        from pilotid.likelihood.estimates import scored

        return scored(self, recording, fitted_to)

    def to_control(self, pade_order: int = 5) -> dict[str, TransferFunction]:
        """The transfer function of each channel by its name, as python-control has them.

        Parameters
        ----------
        pade_order
            Order of the approximants of delays.

        Raises
        ------
        InputError
            If the estimate has no values, or its pilot changes in time.
        """
        if self.model.changes or not np.isfinite(self.values).all():
            why = "its pilot changes in time" if self.model.changes else "it has no values"
            raise InputError(f"the estimate by {self.method} has no transfer functions: {why}")
        names = (channel.name for channel in self.model.channels)
        return dict(zip(names, self.model.rational(self.values, pade_order), strict=True))


def failed(method: str, model: PilotModel, outcome: Outcome, message: str = "") -> Estimate:
    """An estimate without values.

    Parameters
    ----------
    method
        Name of the method.
    model
        The model that it was to fit.
    outcome, message
        How it ended, and details if there are any.
    """
    count = len(model.parameters)
    return Estimate(
        method,
        model,
        outcome,
        values=np.full(count, np.nan),
        covariance=np.full((count, count), np.nan),
        intervals=np.full((count, 2), np.nan),
        message=message,
    )


def symmetric_intervals(values: FloatArray, covariance: FloatArray) -> FloatArray:
    """Value +- 1.96 standard errors, shape (parameters, 2).

    Parameters
    ----------
    values
        Parameters, shape (parameters,).
    covariance
        Their covariance, shape (parameters, parameters).
    """
    reach = Z95 * np.sqrt(np.diag(covariance))
    return np.stack([values - reach, values + reach], axis=1)


def outcome_of(model: PilotModel, values: FloatArray, converged: bool) -> tuple[Outcome, str]:
    """Outcome of a search that ended at `values`, and the bounds it ended at, in words.

    Parameters
    ----------
    model
        The model.
    values
        Parameters in model order, shape (parameters,).
    converged
        Whether the search converged.
    """
    bounds = bounds_reached(model, values)
    if not converged:
        return Outcome.NOT_CONVERGED, bounds
    return (Outcome.AT_BOUND if bounds else Outcome.CONVERGED), bounds


def at_bounds(
    model: PilotModel, lower: FloatArray, upper: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Which parameters reach their lower and their upper bound, shapes (parameters,).

    Parameters
    ----------
    model
        The model.
    lower, upper
        Ends of intervals, or twice the values, shape (parameters,).
    """
    margin = 1e-6 * (model.upper - model.lower)
    low = lower <= model.lower + np.minimum(margin, 1e-6 * np.abs(model.lower) + 1e-9)
    return low, upper >= model.upper - margin


def is_at_bound(model: PilotModel, values: FloatArray) -> BoolArray:
    """Which parameters lie at a bound, shape (parameters,), as `values` do."""
    return np.logical_or(*at_bounds(model, values, values))


def bounds_reached(model: PilotModel, values: FloatArray) -> str:
    """Names of the parameters that lie at a bound, empty if none does."""
    low, high = at_bounds(model, values, values)
    named = [
        f"{key} at its {'lower' if is_low else 'upper'} bound {bound:g}"
        for key, is_low, is_high, bound in zip(
            model.keys, low, high, np.where(low, model.lower, model.upper), strict=True
        )
        if is_low or is_high
    ]
    return ", ".join(named)
