"""What a method is, and running one."""

from __future__ import annotations

import math
import os
import re
import time
import traceback
from dataclasses import replace
from importlib import import_module
from typing import Protocol

import numpy as np

from pilotid.estimate.applicability import made_for, motionless_input
from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.parts import AnalysedBand
from pilotid.estimate.warnings import all_remarks
from pilotid.model.model import PilotModel
from pilotid.naming.code import reason
from pilotid.recording.recording import Recording
from pilotid.support.numbers import require_settings
from pilotid.support.types import InputError, one_line

#: The environment variable that asks for tracebacks of methods that raise.
TRACEBACK = "PILOTID_TRACEBACK"

#: Rounding that a correlation matrix may show: Kvis and tlead are correlated at -0.99.
ROUNDING = 1e-6


class Method(Protocol):
    """An estimator: a frozen dataclass of settings, whose label names it in reports."""

    @property
    def name(self) -> str:
        """Name on the command line and in files."""
        ...

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why this method cannot treat the recording, or None.

        Parameters
        ----------
        recording, model
            As for `fit`.

        Returns
        -------
        str or None
            A sentence, which tables show; None if it can.
        """
        ...

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Estimate the model's parameters; a fit that fails says so in its outcome.

        Parameters
        ----------
        recording
            The recording; it is read-only, and all its runs are of one pilot.
        model
            The pilot model, whose parameters fix the order of all numbers.
        rng
            The source of every random number.

        Returns
        -------
        Estimate
        """
        ...


def import_libraries(method: Method) -> None:
    """Import what a fit uses, so that its time has none of it: some take longer than the fit.

    A method's class may name what it imports where it is used, as ``libraries = ("pysindy",)``.
    """
    for library in ("scipy.special", *getattr(method, "libraries", ())):
        import_module(library)


def identify(
    method: Method, recording: Recording, model: PilotModel, rng: np.random.Generator
) -> Estimate:
    """Run a method on a recording, with its objection heeded and its time taken.

    Whatever the method does, the answer is an estimate: what it raises, and what it returns
    that makes no sense, are outcomes.  Only an interruption by the user passes through.
    """
    name, begin = method.name, None
    try:
        require_settings(method)
        model = made_for(recording, model)
        objection = motionless_input(recording, model) or method.objection(recording, model)
        if objection:
            why = one_line(str(objection))
            return failed(name, model, Outcome.NOT_APPLICABLE, why)
        import_libraries(method)
        begin = time.perf_counter()
        estimate = method.fit(recording, model, rng)
        fault = fault_of(estimate, model)
        if fault:
            estimate = failed(name, model, Outcome.INVALID, fault)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # code of others may raise anything, SystemExit as well
        if os.environ.get(TRACEBACK):
            traceback.print_exc()
        estimate = failed(name, model, *_outcome_of(error))
    seconds = float("nan") if begin is None else time.perf_counter() - begin
    if estimate.band is None and estimate.outcome.usable:
        estimate = replace(estimate, band=_band_of(method, recording))
    return replace(
        estimate,
        message=one_line(str(estimate.message)),
        remarks=all_remarks(estimate, recording),
        seconds=seconds,
    )


def _band_of(method: Method, recording: Recording) -> AnalysedBand:
    """The band that a method says it analyses; all frequencies if it says none."""
    highest, nyquist = getattr(method, "band", None), math.pi / recording.dt
    return AnalysedBand(min(float(highest), nyquist) if highest else nyquist)


def _outcome_of(error: BaseException) -> tuple[Outcome, str]:
    """How a fit ended that raised an exception, and why."""
    match error:
        case np.linalg.LinAlgError() | FloatingPointError():
            return Outcome.SINGULAR, str(error)
        case MemoryError():
            return Outcome.OUT_OF_MEMORY, str(error)
        case InputError():  # a sentence already
            return Outcome.CRASHED, str(error)
        case _:
            return Outcome.CRASHED, reason(error)


def method_fault(thing: object) -> str:
    """Why a thing taken from code is no method, empty if it is one."""
    try:
        name = getattr(thing, "name", None)
    except Exception as error:
        return f"its name cannot be read ({reason(error)})"
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.+-]{0,60}", name, re.ASCII):
        return "a method needs a `name` of letters, digits and the signs . + -"
    lacking = [word for word in ("fit", "objection") if not callable(getattr(thing, word, None))]
    return f"a method needs a function `{lacking[0]}`" if lacking else ""


def fault_of(estimate: object, model: PilotModel) -> str:
    """What is wrong with an estimate of a model, empty if it is sound.

    A fit that failed need not give numbers, but what it gives has the right shapes.
    """
    if not isinstance(estimate, Estimate):
        return f"it returned {type(estimate).__name__} in place of an Estimate"
    if estimate.model != model:
        return "it is an estimate of another model"
    count = len(model.parameters)
    shapes = {"values": (count,), "covariance": (count, count), "intervals": (count, 2)}
    if estimate.errors is not None:
        shapes["errors"] = (count,)
    for name, shape in shapes.items():
        given = getattr(estimate, name)
        if (
            not isinstance(given, np.ndarray)
            or given.shape != shape
            or given.dtype.kind not in "fiu"
        ):
            return f"its {name} are no array of real numbers of the shape {shape}"
    outcome: object = estimate.outcome
    if not isinstance(outcome, Outcome):
        return f"its outcome is of the type {type(outcome).__name__}"
    return _senseless(estimate) if estimate.outcome.usable else ""


def _senseless(estimate: Estimate) -> str:
    """What a usable estimate claims that cannot be."""
    values, covariance = estimate.values, estimate.covariance
    low, high = estimate.intervals.T
    claims = [
        covariance,
        estimate.intervals,
        *([] if estimate.errors is None else [estimate.errors]),
    ]
    if np.isfinite(values).all() and all(np.isnan(claim).all() for claim in claims):
        return ""  # values alone
    if not (np.isfinite(values).all() and np.isfinite(covariance).all()):
        return "a value or its covariance is not finite"
    variances = np.diag(covariance)
    if not (variances > 0.0).all():
        return "a variance is not positive"
    correlation = covariance / np.sqrt(np.outer(variances, variances))
    if not np.allclose(correlation, correlation.T, rtol=0.0, atol=ROUNDING):
        return "the covariance is not symmetric"
    if np.linalg.eigvalsh(correlation)[0] < -ROUNDING:
        return "the covariance is not positive"
    if not (np.isfinite(estimate.std_error) & (estimate.std_error > 0.0)).all():
        return "a standard error is not positive"
    if not ((low <= values) & (values <= high)).all():
        return "an interval does not hold its value"
    if not (np.isnan(estimate.vaf) or 0.0 <= estimate.vaf <= 100.0):
        return f"a VAF of {float(estimate.vaf):g} % cannot be"
    return ""
