"""Estimates in files: what `Estimate.to_dict` gives, as JSON, and the way back."""

from __future__ import annotations

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pilotid.estimate.draws import Draws
from pilotid.estimate.estimate import Estimate, Outcome, Starts
from pilotid.estimate.parts import AnalysedBand, RemnantEstimate, Specification
from pilotid.model.catalogue import MODELS
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.support.disk import require_file, strict_json, write_file
from pilotid.support.remarks import Remark
from pilotid.support.types import InputError

T = TypeVar("T")


def save(estimate: Estimate, path: str | os.PathLike[str]) -> None:
    """Write an estimate to a file in the form of ``pilotid fit --json``, with its draws.

    Parameters
    ----------
    estimate
        Any estimate.
    path
        The file, which is written over.
    """
    told = {"model": estimate.model.name, "estimates": [estimate.to_dict(draws=True)]}
    write_file(Path(path), strict_json(told).encode())


def load_estimate(
    path: str | os.PathLike[str], method: str | None = None, model: PilotModel | None = None
) -> Estimate:
    """The estimate that `save` or ``pilotid fit --json`` wrote.

    It has no responses of a first step, and of the latter no draws.

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
        found = json.loads(file.read_text(encoding="utf-8"))
        every = [e for own in (found if isinstance(found, list) else [found])
                 for e in own["estimates"]]  # fmt: skip
        some = [e for e in every if method in (None, e["method"])]
        if len(some) == 1:
            return _estimate(some[0], model)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        if isinstance(error, InputError):
            raise InputError(f"{file}: {error}") from None
        raise InputError(
            f"{file}: holds no estimate; give a file that pilotid.save or pilotid fit --json wrote"
        ) from error
    raise InputError(
        f"{file}: holds {len(some)} estimates, of {', '.join(e['method'] for e in every)}; name "
        "the method of one, as in load_estimate(path, 'mle')"
    )


def _estimate(told: dict[str, Any], model: PilotModel | None) -> Estimate:
    model = model or _model(told["model"], told["held"])
    numbers = told["parameters"]
    if tuple(numbers) != model.keys:
        raise InputError(f"is an estimate of {', '.join(numbers)}, not of model {model.name}")
    covariance = np.array(told["covariance"], dtype=float)
    errors = np.array([own["std_error"] for own in numbers.values()], dtype=float)
    outcome = next(o for o in Outcome if o.slug == told["outcome"])
    return Estimate(
        told["method"],
        model,
        outcome,
        values=np.array([own["value"] for own in numbers.values()], dtype=float),
        covariance=covariance,
        intervals=np.array([own["interval_95"] for own in numbers.values()], dtype=float),
        vaf=_number(told["vaf"]),
        message=told["message"].removeprefix(outcome.value)[2:-1],
        iterations=told["iterations"],
        starts=_made(Starts, told["starts"]),
        remnant=_made(RemnantEstimate, told.get("remnant")),
        errors=None if np.array_equal(errors, np.sqrt(np.diag(covariance)), True) else errors,
        draws=_made(Draws, told.get("draws")),
        remarks=tuple(map(Remark, told["codes"], told["remarks"], told["grades"])),
        criterion=_number(told["criterion"]),
        seconds=_number(told["seconds"]),
        band=_made(AnalysedBand, told["band"]),
        specification=_made(Specification, told["specification"]),
    )


def _number(given: float | None) -> float:
    return float("nan") if given is None else given


def _made(kind: type[T], told: dict[str, Any] | None) -> T | None:
    """A part from the entries that are its fields, None from nothing."""
    if told is None:
        return None
    own: dict[str, Any] = {}
    for field in fields(kind):  # type: ignore[arg-type]
        value, form = told[field.name], str(field.type)
        if "Array" in form:
            value = np.array(value, dtype=bool if "Bool" in form else float)
        elif form.startswith("tuple"):
            value = tuple(value)
        own[field.name] = _number(value) if form == "float" else value
    return kind(**own)


def _model(told: dict[str, Any], held: dict[str, float]) -> PilotModel:
    """The model of the catalogue with this name, element, bounds and values that are held."""
    if told["name"] not in MODELS:
        raise InputError(
            f"model {told['name']} is none of the catalogue; give it, as in "
            "load_estimate(path, model=mine)"
        )
    model = MODELS[told["name"]]
    if element := _made(ControlledElement, told["element"]):
        model = model.with_element(element)
    model = model.with_fixed(**held)
    known = zip(model.keys, model.lower.tolist(), model.upper.tolist(), strict=True)
    was = {key: (low, high) for key, low, high in known}
    bounds = {key: tuple(own) for key, own in told["bounds"].items() if tuple(own) != was.get(key)}
    return model.with_bounds(**bounds) if bounds else model
