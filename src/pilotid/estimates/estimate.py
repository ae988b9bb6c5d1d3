"""What a method is and what it returns."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.draws import Draws
from pilotid.estimates.remnant import RemnantEstimate
from pilotid.estimates.response import FrequencyResponse
from pilotid.pilot.model import PilotModel
from pilotid.types import FloatArray


class Outcome(enum.Enum):
    """How a fit ended; the value is the sentence that tables and reports show."""

    CONVERGED = "converged"
    AT_BOUND = "converged with a parameter at its bound, where intervals mean little"
    NOT_CONVERGED = "did not converge within the iteration limit"
    NEGATIVE_DELAY = "failed: a time delay was driven negative"
    DIVERGED = "failed: the model's response diverged"
    SINGULAR = "failed: the information matrix is singular"
    UNSTABLE_MODEL = "failed: the first-step model is unusable"
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
        Final cost of each start over the lowest one, ascending, so that 1 is the best.
    agreeing
        Number of starts that ended in the best optimum.
    """

    cost: FloatArray
    agreeing: int


@dataclass(frozen=True, eq=False)
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
    draws
        Draws of the posterior, where the method has one.
    remarks
        What a user must know before believing it, a sentence each; empty if all is well.
    seconds
        Wall-clock time of the fit.
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
    draws: Draws | None = None
    remarks: tuple[str, ...] = ()
    seconds: float = float("nan")

    @property
    def std_error(self) -> FloatArray:
        """Claimed standard errors, shape (parameters,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> FloatArray:
        """Claimed correlation matrix, shape (parameters, parameters)."""
        error = self.std_error
        return self.covariance / np.outer(error, error)

    @property
    def sentence(self) -> str:
        """The outcome in words, with the details."""
        return f"{self.outcome.value} ({self.message})" if self.message else self.outcome.value


def failed(method: str, model: PilotModel, outcome: Outcome, message: str = "") -> Estimate:
    """An estimate without values."""
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
    """Value +- 1.96 standard errors, shape (parameters, 2)."""
    reach = Z95 * np.sqrt(np.diag(covariance))
    return np.stack([values - reach, values + reach], axis=1)


def outcome_of(model: PilotModel, values: FloatArray, converged: bool) -> tuple[Outcome, str]:
    """Outcome of a search that ended at `values`, and the bounds it ended at, in words."""
    bounds = _at_bound(model, values)
    if not converged:
        return Outcome.NOT_CONVERGED, bounds
    return (Outcome.AT_BOUND if bounds else Outcome.CONVERGED), bounds


def _at_bound(model: PilotModel, values: FloatArray) -> str:
    """Names of the parameters that lie at a bound, empty if none does."""
    margin = 1e-6 * (model.upper - model.lower)
    low = values <= model.lower + np.minimum(margin, 1e-6 * np.abs(model.lower) + 1e-9)
    high = values >= model.upper - margin
    named = [
        f"{key} at its {'lower' if is_low else 'upper'} bound {bound:g}"
        for key, is_low, is_high, bound in zip(
            model.keys, low, high, np.where(low, model.lower, model.upper), strict=True
        )
        if is_low or is_high
    ]
    return ", ".join(named)
