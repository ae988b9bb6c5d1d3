"""What a method is, and the estimates that one or several make of a recording."""

from __future__ import annotations

import math
import os
import re
import sys
import time
import traceback
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import Protocol

import numpy as np

from pilotid.checks.checks import remarks
from pilotid.checks.element_fit import ElementChoice, GivenElement, chosen_element
from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.loops import Loops
from pilotid.estimate.quantities import AnalysedBand
from pilotid.estimate.warnings import all_remarks, made_for, motionless_input
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import forcing_sines
from pilotid.support.numbers import fit_rng, require_settings
from pilotid.support.remarks import Remark, gravest_first, remark_of, remarks_json
from pilotid.support.types import InputError, one_line, reason

#: The environment variable that asks for tracebacks of methods that raise.
TRACEBACK = "PILOTID_TRACEBACK"


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


def identify(
    method: Method, recording: Recording, model: PilotModel, rng: np.random.Generator
) -> Estimate:
    """Run a method on a recording, with its objection heeded and its time taken.

    Whatever the method does, the answer is an estimate: what it raises, and what it returns
    that makes no sense, are outcomes.  Only an interruption by the user passes through.

    A method's class may name what its fit imports where it is used, ``libraries = ("pysindy",)``,
    and the highest frequency that it analyses, ``band`` [rad/s]; None for all.
    """
    name, begin = method.name, None
    try:
        require_settings(method)
        model = made_for(recording, model)
        objection = motionless_input(recording, model) or method.objection(recording, model)
        if objection:
            why = one_line(str(objection))
            return failed(name, model, Outcome.NOT_APPLICABLE, why)
        # The time of a fit has no imports in it, of which some take longer than the fit.
        for library in ("scipy.special", *getattr(method, "libraries", ())):
            import_module(library)
        begin = time.perf_counter()
        with np.errstate(all="ignore"):  # a search looks anywhere, and what is no number loses
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
        highest = getattr(method, "band", None) or math.inf
        band = AnalysedBand(min(float(highest), math.pi / recording.dt))
        estimate = replace(estimate, band=band)
    return replace(
        estimate,
        message=one_line(str(estimate.message)),
        remarks=all_remarks(estimate, recording),
        seconds=seconds,
    )


def signals_in(recording: Recording) -> list[bytes]:
    """All signals as they are now, which tells later whether a method changed them."""
    return [signal.tobytes() for signal in recording.arrays.values()]


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
    name = getattr(thing, "name", None)
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
    for name, shape in shapes.items():
        given = getattr(estimate, name)
        is_real = isinstance(given, np.ndarray) and given.dtype.kind in "fiu"
        if not (is_real and given.shape == shape):
            return f"its {name} are no array of real numbers of the shape {shape}"
    values, covariance = estimate.values, estimate.covariance
    low, high = estimate.intervals.T
    if not estimate.outcome.usable:
        return ""
    # What a method does not claim is NaN.
    if not np.isfinite(values).all() or np.isinf(covariance).any():
        return "a value or its covariance is not finite"
    if not ((np.diag(covariance) > 0.0) | np.isnan(covariance).all()).all():
        return "a variance is not positive"
    if not (((low <= values) & (values <= high)) | np.isnan(low) & np.isnan(high)).all():
        return "an interval does not hold its value"
    return ""


@dataclass(frozen=True, eq=False)
class Fitted:
    """All estimates of one model from one recording.

    Attributes
    ----------
    recording, model
        What was fitted to what.
    estimates
        One for each method.
    loop_element
        The controlled element that loops are drawn with, or why there is none.
    remarks
        What is wrong with the recording, a sentence each.
    choice
        Why the model was chosen, in sentences; empty where it was named.
    compared
        Plain objects on the models that were compared.
    """

    recording: Recording
    model: PilotModel
    estimates: tuple[Estimate, ...]
    loop_element: ElementChoice
    remarks: tuple[str, ...] = ()
    choice: str = ""
    compared: tuple[Mapping[str, object], ...] = ()

    @cached_property
    def loops(self) -> tuple[Loops, ...]:
        """The loops of each estimate, in their order; empty where no element is known."""
        element = self.loop_element.element
        if element is None:
            return ()
        return tuple(e.loops(element).excited_by(self.recording) for e in self.estimates)

    @property
    def heading(self) -> str:
        """One line that says what was fitted to what."""
        return f"{self.recording.description}; model {self.model.name}"

    def to_dict(self) -> dict[str, object]:
        """Plain objects, in the form that `pilotid fit --json` writes."""
        return {
            "recording": {
                **self.recording.to_dict(),
                "forcing": forcing_sines(self.recording),
                **remarks_json(self.remarks),
            },
            "model": self.model.name,
            **({"choice": self.choice, "models": list(self.compared)} if self.choice else {}),
            "estimates": [
                {**estimate.to_dict(), **loops}
                for estimate, loops in zip(self.estimates, self._loop_dicts(), strict=True)
            ],
        }

    def _loop_dicts(self) -> list[dict[str, object]]:
        """What the loops add to each estimate's object."""
        given = self.loop_element
        if given.element is None:
            why = Remark("element-unknown", given.why)
            return [{"loops": {"element": None, **remarks_json([why])}} for _ in self.estimates]
        return [{"loops": {**loops.to_dict(), "origin": given.origin}} for loops in self.loops]

    @property
    def graded(self) -> dict[Remark, str]:
        """All remarks, each once with what it is about, those that say what is wrong first."""
        said = [("recording", remark_of(remark)) for remark in self.remarks]
        said += [(e.method, remark_of(remark)) for e in self.estimates for remark in e.remarks]
        pairs = zip(self.estimates, self.loops, strict=False)
        said += [(e.method, remark_of(remark)) for e, loops in pairs for remark in loops.remarks]
        about: dict[Remark, str] = {}
        for remark in gravest_first(remark for _, remark in said):
            about[remark] = ", ".join(dict.fromkeys(who for who, other in said if other == remark))
        return about

    @property
    def warnings(self) -> list[str]:
        """All remarks in words, those that say what is wrong first."""
        return [remark.line(about) for remark, about in self.graded.items()]


def fit_all(
    recording: Recording,
    model: PilotModel,
    methods: Mapping[str, Method],
    seed: int,
    element: GivenElement = None,
) -> Fitted:
    """Run methods, by their labels, on a recording, each with its own random generator.

    Parameters
    ----------
    recording, model, methods, seed
        What is fitted to what.
    element
        The controlled element; None for the one that the recording names or shows.
    """
    chosen = chosen_element(recording, element)
    closed = chosen.named_in(recording)
    with redirect_stdout(sys.stderr):  # what methods of others print is no part of an answer
        estimates = tuple(
            replace(identify(method, closed, model, fit_rng(seed, label)), method=label)
            for label, method in methods.items()
        )
    return Fitted(recording, model, estimates, chosen, (*remarks(closed), *chosen.remarks))
