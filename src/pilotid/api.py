"""What a user needs: identify, simulate and compare, by names or objects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast, overload

import numpy as np

from pilotid.datasets.named import AnyScenario, scenario_named
from pilotid.datasets.population import Population
from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.simulation import simulate as simulated
from pilotid.estimate.estimate import Estimate
from pilotid.estimate.method import Method
from pilotid.estimate.method import identify as run_method
from pilotid.methods import label_of, method_named
from pilotid.model.catalogue import model_named
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.support.numbers import DEFAULT_SEED, draw_rng, fit_rng, recording_rng
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pilotid.datasets.design import Design
    from pilotid.likelihood.choice import Selection
    from pilotid.report.check import Checked
    from pilotid.study.table import Comparison
    from pilotid.study.trust import Trust

T = TypeVar("T")


@overload
def identify(
    recording: Recording,
    model: PilotModel | str,
    method: Method | str = ...,
    rng: np.random.Generator | int = ...,
) -> Estimate: ...
@overload
def identify(
    recording: Method | str,
    model: Recording,
    method: PilotModel | str,
    rng: np.random.Generator | int = ...,
) -> Estimate: ...
def identify(
    recording: Recording | Method | str,
    model: PilotModel | Recording | str,
    method: Method | PilotModel | str = "mle",
    rng: np.random.Generator | int = DEFAULT_SEED,
) -> Estimate:
    """Identify a pilot model from a recording: ``identify(recording, "multi", "mle")``.

    The order of former versions, method, recording, model, is understood as well.

    Parameters
    ----------
    recording
        The recording.
    model
        A model, or its name in `pilotid.MODELS`.
    method
        A method, or what the command line takes for one, such as ``arx(memory=none)``.
    rng
        A random generator, or the seed of one: the same seed gives the same estimate, the one
        that ``pilotid fit --seed`` prints.

    Returns
    -------
    Estimate
        Whatever happens; one that failed says so in its outcome.  Its remarks begin with what
        `check` says of the recording.
    """
    if isinstance(model, Recording):
        recording, model, method = model, cast(PilotModel | str, method), cast(Method, recording)
    chosen = method_named(method) if isinstance(method, str) else cast(Method, method)
    if not isinstance(rng, np.random.Generator):
        rng = fit_rng(rng, label_of(chosen))
    known = _require(recording, Recording, "recording")
    estimate = run_method(chosen, known, _model(model), rng)
    return replace(estimate, remarks=(*check(known).remarks, *estimate.remarks))


def _model(given: PilotModel | str) -> PilotModel:
    return _require(model_named(given) if isinstance(given, str) else given, PilotModel, "model")


def _require(thing: object, kind: type[T] | tuple[type[T], ...], name: str) -> T:
    """Refuse a thing of another kind in a sentence."""
    if not isinstance(thing, kind):
        wanted = str(getattr(kind, "__name__", "Scenario"))
        raise InputError(f"{name} {thing!r:.50}: must be a {wanted}, not {type(thing).__name__}")
    return thing


def check(
    recording: Recording,
    element: ControlledElement | str | None = None,
) -> Checked:
    """Say what was understood of a recording, and what is wrong: ``print(check(recording))``.

    Parameters
    ----------
    recording
        The recording.
    element
        The controlled element, or its text, to compare with what is seen.

    Returns
    -------
    Checked
        Remarks with codes and grades, signals, lines and element; it prints as ``pilotid check``
        does, and its ``to_dict()`` is what ``--json`` writes.
    """
    from pilotid.report.check import check_all

    _require(recording, Recording, "recording")
    (checked,) = check_all([recording], element)
    return checked


def which_model(
    recording: Recording, *models: PilotModel | str, seed: int = DEFAULT_SEED
) -> Selection:
    """Choose a pilot model for a recording: ``which_model(recording).model``.

    Parameters
    ----------
    recording
        The recording.
    models
        The candidates, models or names; none for those of the catalogue that the recording can
        tell apart, as ``pilotid fit --model auto``.
    seed
        Seed of the searches' random starts.

    Returns
    -------
    Selection
        The model, the reason in words, and the figures of all candidates.
    """
    from pilotid.likelihood.choice import select

    named = [_model(m) for m in models]
    _require(recording, Recording, "recording")
    return select(recording, named, seed)


def simulate(
    scenario: AnyScenario | str = "nominal", rng: np.random.Generator | int = DEFAULT_SEED
) -> Recording:
    """Simulate one recording of a scenario: ``simulate("nominal", 7)``.

    Parameters
    ----------
    scenario
        A scenario or a population, of which one pilot is drawn; or what the command line takes
        for one.
    rng
        A random generator, or the seed of one: the same seed gives the recording that
        ``pilotid simulate --seed`` writes.

    Returns
    -------
    Recording
    """
    chosen = scenario_named(scenario) if isinstance(scenario, str) else scenario
    _require(chosen, (Scenario, Population), "scenario")
    if isinstance(rng, np.random.Generator):
        return simulated(chosen.drawn(rng), rng)
    drawn = chosen.drawn(draw_rng(rng, chosen.name))
    return simulated(drawn, recording_rng(rng, chosen.name))


def compare(
    scenarios: Iterable[AnyScenario | str] = ("nominal",),
    methods: Iterable[Method | str] = ("mle-white", "mle"),
    replications: int = 25,
    *,
    out: str | Path,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
) -> Comparison:
    """Compare methods on simulated recordings; a study that was stopped goes on where it was.

    The fits run in processes of their own, which do not import the script that calls it.

    Parameters
    ----------
    scenarios, methods
        Objects, or what the command line takes for them.
    replications
        Recordings of each scenario.
    out
        Folder of the store; ``pilotid report`` makes tables and a page of it.
    seed
        Seed of all random numbers.
    workers
        Processes; None for one for each processor.

    Returns
    -------
    Comparison
        All that the store holds then.
    """
    from pilotid.study.study import Study

    return Study(scenarios, methods, replications, seed).run_in(Path(out), workers)


def trust(
    recording: Recording,
    model: PilotModel | str | None = None,
    methods: Iterable[Method | str] = (),
    replications: int = 40,
    *,
    out: str | Path,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
) -> Trust:
    """Try a fit on simulations of its recording: ``trust(recording, out="trust").sentences``.

    Parameters
    ----------
    recording
        The recording.
    model
        A model or its name; None for what `which_model` chooses.
    methods
        Objects or names; the fit by the first is judged. None for all, and ``mle``.
    replications
        Simulations of the recording.
    out, seed, workers
        As for `compare`.

    Returns
    -------
    Trust
        Bias, coverage and corrected interval of each parameter, and the comparison of methods.
    """
    from pilotid.study.trust import try_fit

    chosen = which_model(recording, seed=seed).model if model is None else _model(model)
    trusted = try_fit(recording, chosen, methods, Path(out), replications, seed, workers)
    trusted.comparison.write(Path(out))
    return trusted


def design(
    scenario: Scenario | str = "nominal",
    minimise: str = "A",
    *,
    limits: Mapping[str, float] | None = None,
) -> Design:
    """Design forcing functions: ``design(limits={"e": 1.5, "u": 1.5}).errors``.

    Parameters
    ----------
    scenario
        Pilot, loop, remnant and window, or its name; its forcing functions are the reference.
    minimise
        ``A``, ``D`` or parameters, of relative errors.
    limits
        Largest variances of ``e`` and ``u`` over those of the reference; 1 if None.

    Returns
    -------
    Design
        Predicted errors, costs in e and u, crest factors, and the ``scenario`` of the design,
        which `simulate` and `compare` take.
    """
    from pilotid.datasets.design import REFERENCE
    from pilotid.datasets.design import design as designed

    named = scenario_named(scenario) if isinstance(scenario, str) else scenario
    one = _require(named, Scenario, "scenario")
    return designed(one, minimise, REFERENCE if limits is None else limits)
