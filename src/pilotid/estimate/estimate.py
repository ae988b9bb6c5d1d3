"""What a method returns: an outcome, values, their uncertainty, and how it came to them."""

from __future__ import annotations

import enum
import json
import math
import os
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pilotid.estimate.loops import Loops, loops_of
from pilotid.estimate.quantities import (
    AnalysedBand,
    Draws,
    FrequencyResponse,
    Pair,
    Quantity,
    RemnantEstimate,
    Specification,
    combined,
    frame_of,
    plain_fields,
    quantity_tables,
    spans_decade,
)
from pilotid.model.catalogue import MODELS
from pilotid.model.element import ControlledElement, as_element
from pilotid.model.factors import Inverse
from pilotid.model.model import PilotModel
from pilotid.support.disk import require_file, strict_json, write_file
from pilotid.support.format import as_text
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import Z95
from pilotid.support.remarks import Remark, remark_of, remarks_json
from pilotid.support.types import BoolArray, FloatArray, InputError

if TYPE_CHECKING:
    from control import TransferFunction
    from pandas import DataFrame

    from pilotid.likelihood.estimates import Score
    from pilotid.recording.recording import Recording

T = TypeVar("T")


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
        What the search made small, up to a constant of the recording, its band and the free decays
        that are fitted with it: -2 log-likelihood and Akaike's penalty for all parameters that are
        fitted, about 2 for each, so that one that is held takes 2 away; NaN where there is none.
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
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> FloatArray:
        """Claimed correlation matrix, shape (parameters, parameters)."""
        errors = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(errors, errors))

    @property
    def sentence(self) -> str:
        """The outcome in words, with the details."""
        return f"{self.outcome.value} ({self.message})" if self.message else self.outcome.value

    @property
    def parameters(self) -> list[Quantity]:
        """The model's parameters, in model order."""
        numbers = np.column_stack([self.values, self.std_error, self.intervals]).tolist()
        every = zip(self.model.parameters, numbers, self.determined.tolist(), strict=True)
        return [
            Quantity(p.key, p.unit, value, error, low, high, known)
            for p, (value, error, low, high), known in every
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
        """Pairs of parameters that the recording cannot tell apart.

        They are correlated, by the draws where there are some, and one of them is little known.
        """
        if not (np.isfinite(self.values).all() and np.isfinite(self.covariance).all()):
            return []
        keys, positive = self.model.keys, self.model.positive & (self.values > 0.0)
        if self.draws is None:
            scale = np.where(positive, self.values, 1.0)
            spread = self.covariance / np.outer(scale, scale)
        else:
            draws = self.draws.values[:, : len(keys)]
            inner = np.where(positive, np.log(np.where(positive, draws, 1.0)), draws)
            spread = np.atleast_2d(np.cov(inner.T, ddof=0))
        error = np.sqrt(np.diag(spread))
        if not (error > 0.0).all():
            return []
        correlation = spread / np.outer(error, error)
        relative = np.where(positive, error, error / np.maximum(np.abs(self.values), 1e-9))
        vague = np.maximum.outer(relative, relative) > ESTIMATE.well_known
        places = np.argwhere(np.triu(vague & (np.abs(correlation) >= ESTIMATE.collinear), 1))
        return [Pair(keys[i], keys[j], float(correlation[i, j])) for i, j in places]

    @property
    def quantities(self) -> list[Quantity]:
        """Parameters, and products and sums of them."""
        return [*self.parameters, *self.derived]

    def __getitem__(self, key: str) -> Quantity:
        """A parameter, product or sum by its key: value, standard error, interval and unit."""
        by_key = {quantity.key: quantity for quantity in self.quantities}
        if key not in by_key:
            raise KeyError(f"{key}: the estimate has {', '.join(by_key)}")
        return by_key[key]

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
        """All quantities, verdict and remarks, as `pilotid fit` prints them."""
        lines = []
        if np.isfinite(self.values).any():
            (table,) = quantity_tables([(self.method, self.quantities)])
            lines += [as_text(table), ""]
        tested = [self.specification.sentence] if self.specification else []
        return "\n".join([*lines, *self.model.held_words, *tested, self.verdict(), *self.remarks])

    def summary(self) -> str:
        """All quantities, the verdict and the remarks, to print."""
        return repr(self)

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
                {"parameters": pair[:2], "correlation": pair.correlation}
                for pair in self.inseparable
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
            result["remnant"] = plain_fields(self.remnant)
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
        given = as_element(element)
        return loops_of(self.model, self.values, self.covariance, self.draws, given)

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
    named = []
    for p, is_low, is_high in zip(model.parameters, *at_bounds(model, values, values), strict=True):
        if is_low or is_high:
            side, bound = ("lower", p.lower) if is_low else ("upper", p.upper)
            named.append(f"{p.key} at its {side} bound {bound:g}")
    return ", ".join(named)


# ------------------------------------------------------------------------------- files


def save(estimate: Estimate, path: str | os.PathLike[str]) -> None:
    """Write an estimate to a file in the form of ``pilotid fit --json``, with its draws.

    Parameters
    ----------
    estimate
        Any estimate.
    path
        The file, which is written over.
    """
    entry = {"model": estimate.model.name, "estimates": [estimate.to_dict(draws=True)]}
    write_file(Path(path), strict_json(entry).encode())


def load_estimate(
    path: str | os.PathLike[str], method: str | None = None, model: PilotModel | None = None
) -> Estimate:
    """The estimate that `save` or ``pilotid fit --json`` wrote.

    Responses of a first step have the variances of their errors alone, in equal parts for real and
    imaginary parts; covariances are NaN.  What ``pilotid fit`` wrote has no draws.

    Parameters
    ----------
    path
        The file.
    method
        Which of several estimates; None where there is one.
    model
        The model, needed where it is none of the catalogue.

    Raises
    ------
    InputError
        If the file holds no estimate or several, or the model is not known.
    """
    file = Path(path)
    require_file(file)
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        fits = content if isinstance(content, list) else [content]
        every = [entry for fit in fits for entry in fit["estimates"]]
        chosen = [entry for entry in every if method in (None, entry["method"])]
        if len(chosen) == 1:
            return _estimate(chosen[0], model or _model(chosen[0]))
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{file}: holds no estimate; give a file that pilotid.save or pilotid fit --json wrote"
        ) from error
    raise InputError(
        f"{file}: holds {len(chosen)} estimates, of {', '.join(e['method'] for e in every)}; name "
        "the method of one, as in load_estimate(path, 'mle')"
    )


def _estimate(entry: dict[str, Any], model: PilotModel) -> Estimate:
    numbers = entry["parameters"]
    if tuple(numbers) != model.keys:
        raise InputError(f"is an estimate of {', '.join(numbers)}, not of model {model.name}")
    values, errors, intervals = (
        np.array([number[name] for number in numbers.values()], dtype=float)
        for name in ("value", "std_error", "interval_95")
    )
    covariance = np.array(entry["covariance"], dtype=float)
    outcome = next(o for o in Outcome if o.slug == entry["outcome"])
    return Estimate(
        entry["method"],
        model,
        outcome,
        values,
        covariance,
        intervals,
        message=entry["message"].removeprefix(outcome.value)[2:-1],
        iterations=entry["iterations"],
        errors=None if np.array_equal(errors, np.sqrt(np.diag(covariance)), True) else errors,
        remarks=tuple(map(Remark, entry["codes"], entry["remarks"], entry["grades"])),
        vaf=_number(entry["vaf"]),
        criterion=_number(entry["criterion"]),
        seconds=_number(entry["seconds"]),
        starts=_part(Starts, entry["starts"]),
        remnant=_part(RemnantEstimate, entry.get("remnant")),
        frequency_response=_responses(entry.get("frequency_response"), model),
        draws=_part(Draws, entry.get("draws")),
        band=_part(AnalysedBand, entry["band"]),
        specification=_part(Specification, entry["specification"]),
    )


def _responses(entry: dict[str, Any] | None, model: PilotModel) -> FrequencyResponse | None:
    """The first step of a two-step method from its entry, None from nothing."""
    if entry is None:
        return None
    channels = [entry[channel.name] for channel in model.channels]
    parts = {name: np.array([c[name] for c in channels], dtype=float) for name in channels[0]}
    covariance = np.diag(np.tile(0.5 * parts["std"].ravel() ** 2, 2))
    covariance[~np.eye(len(covariance), dtype=bool)] = math.nan
    return FrequencyResponse(
        np.array(entry["omega"], dtype=float),
        parts["real"] + 1j * parts["imag"],
        covariance,
        parts.get("systematic"),
        entry.get("note", ""),
    )


def _number(given: float | None) -> float:
    return math.nan if given is None else given


def _part(kind: type[T], entry: dict[str, Any] | None) -> T | None:
    """A part of an estimate from the entries that are its fields, None from nothing."""
    if entry is None:
        return None
    values: dict[str, Any] = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if field.name not in entry and field.default is not MISSING:
            continue  # of a file that is older than the field
        value, form = entry[field.name], str(field.type)
        if "Array" in form:
            value = np.array(value, dtype=bool if "Bool" in form else float)
        elif form.startswith("tuple"):
            value = tuple(value)
        values[field.name] = _number(value) if form == "float" else value
    return kind(**values)


def _model(entry: dict[str, Any]) -> PilotModel:
    """The model of the catalogue with the name, element, bounds and fixed values of an entry."""
    about = entry["model"]
    if about["name"] not in MODELS:
        raise InputError(
            f"model {about['name']} is none of the catalogue; give it, as in "
            "load_estimate(path, model=mine)"
        )
    model = MODELS[about["name"]]
    if element := _part(ControlledElement, about["element"]):
        model = model.with_element(element)
    model = model.with_fixed(**entry["held"])
    usual = {p.key: [p.lower, p.upper] for p in model.parameters}
    return model.with_bounds(
        **{key: tuple(ends) for key, ends in about["bounds"].items() if ends != usual.get(key)}
    )
