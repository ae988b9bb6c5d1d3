"""How far a fit of one recording can be trusted: methods on simulations of this very recording.

The fit is taken for the truth, recordings like this one are simulated, and each method fits them: a
parametric bootstrap.  What it tells holds as far as the pilot is linear and the model right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.datasets import AnyScenario, Scenario
from pilotid.datasets.named import designed_scenario, scenario_json
from pilotid.datasets.recorder import Recorder
from pilotid.datasets.scenarios import checked
from pilotid.datasets.signals import Multisine, TabulatedRemnant
from pilotid.estimate.estimate import Estimate
from pilotid.estimate.loops import stabilised_element
from pilotid.estimate.method import Fitted, Method, identify
from pilotid.estimate.quantities import RemnantEstimate, Specification
from pilotid.estimate.warnings import element_unknown
from pilotid.methods import METHODS, label_of, method_named
from pilotid.model.catalogue import MODELS
from pilotid.model.element import ControlledElement
from pilotid.model.loops import pilot_on
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of, known_lines
from pilotid.study.study import Study
from pilotid.study.table import Comparison, judge
from pilotid.support.disk import make_folder, strict_json, write_file
from pilotid.support.naming import name_of
from pilotid.support.numbers import DEFAULT_SEED, fit_rng, rms
from pilotid.support.types import FloatArray, InputError, IntArray

#: Fits the recording where nothing else is named, and makes the simulated pilot.
DEFAULT_METHOD = "mle"
COVERED = 0.95
TRUST = "trust.json"
#: rms of the difference of two signals, over their own, up to which they are the same.
SAME_SIGNAL = 0.02
RETURN_SECONDS = 5.0  # seconds in which a signal without whole periods returns to where it began
SMALLEST_LINE = 1e-3  # a line is kept if its amplitude is at least this share of the largest one
FAINT = 1e-4  # share of a signal's rms below which a recorder's noise is left out
#: What no simulation of a fit can tell.
UNKNOWN = (
    "This cannot know whether the pilot is linear and constant, and whether model and controlled "
    "element are right: what is wrong with them is wrong in the simulations too."
)


def length_factor(value: FloatArray, lower: FloatArray, upper: FloatArray, truth: float) -> float:
    """What lengths of 95 % intervals are to be multiplied by, so that 95 % hold the truth.

    Each interval needs a factor, by which it just reaches the truth when both sides are stretched
    from the value; of n the ceil(.95 (n + 1))-th smallest will do for 95 % of others.

    Parameters
    ----------
    value, lower, upper
        Values and ends of the intervals, shape (fits,).
    truth
        The true value.

    Returns
    -------
    float
        NaN with fewer than 19 intervals.
    """
    side = np.where(truth > value, upper - value, value - lower)
    known = np.isfinite(value) & ~np.isnan(side)
    missed, side = np.abs(truth - value)[known], side[known]
    place = math.ceil(COVERED * (missed.size + 1) - 1e-9)
    if place > missed.size:
        return math.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.where(missed == 0.0, 0.0, missed / np.maximum(side, 0.0))
    return float(np.sort(needed)[place - 1])


@dataclass(frozen=True, eq=False)
class Trust:
    """What simulations of a recording say of a fit to it.

    Attributes
    ----------
    recording
        Where the recording came from.
    estimate, label
        The fit of the recording, and the label of its method.
    specification
        The test of the simulated fit against the forcing functions; None where there is none.
    comparison
        All fits of the simulations.
    """

    recording: str
    estimate: Estimate
    label: str
    specification: Specification | None
    comparison: Comparison

    @cached_property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """What the simulations say of each parameter of the fit, by its key.

        ``value`` in the recording, ``unit``; ``interval_95`` as claimed, and ``corrected_95``,
        whose length is multiplied by ``factor``, see `length_factor`; ``bias``, the mean error on
        simulations, in the parameter's unit, and ``bias_claimed``, in claimed standard errors,
        each with its Monte Carlo error; ``coverage`` of the 95 % intervals on simulations, with
        its own 95 % interval, ``coverage_95``, and ``coverage_p``, the p-value of 95 %.
        """
        from scipy.stats import binom

        (scenario,) = self.comparison.scenarios
        fits = self.comparison.cell(scenario, self.label)
        scores = self.comparison.scored(scenario, self.label).set_index("parameter")
        known = {}
        model = self.estimate.model
        for q, *limits in zip(self.estimate.parameters, model.lower, model.upper, strict=True):
            row = scores.loc[q.key]
            good = fits[fits.usable & (fits.parameter == q.key)]
            value, lower, upper = (good[name].to_numpy() for name in ("value", "low", "high"))
            factor = length_factor(value, lower, upper, row.truth)
            hits = np.count_nonzero((lower <= row.truth) & (row.truth <= upper))
            covering = binom(np.count_nonzero(~np.isnan(lower)), COVERED)
            low = q.value - factor * (q.value - q.lower)
            high = q.value + factor * (q.upper - q.value)
            if math.isfinite(factor):  # no end lies outside the bounds of the search
                low, high = max(low, limits[0]), min(high, limits[1])
            known[q.key] = {
                "parameter": q.key,
                "unit": q.unit,
                "value": q.value,
                "interval_95": (q.lower, q.upper),
                "corrected_95": (low, high),
                "bias": (row.bias, row.bias_se),
                "bias_claimed": (row.mean_z, row.mean_z_se),
                "coverage": row.coverage_95,
                "coverage_95": (row.coverage_lower, row.coverage_upper),
                "coverage_p": min(1.0, 2.0 * min(covering.cdf(hits), covering.sf(hits - 1))),
                "factor": factor,
            }
        return known

    @property
    def sentences(self) -> list[str]:
        """What makes the simulations worthless, and each parameter whose coverage is off.

        It is off where its p-value is below .05 for all parameters together (Bonferroni).
        """
        tested = self.specification
        sentences = [
            _advice(self.label, p)
            for p in self.parameters.values()
            if p["coverage_p"] * len(self.parameters) < 1.0 - COVERED
        ]
        if tested is None or tested.agrees:
            return sentences
        return [
            f"The fit that was simulated contradicts the forcing functions (p = "
            f"{tested.p_value:.1g}): the recorded pilot is another one than the simulated, and "
            "nothing that follows can be believed of it.",
            *sentences,
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain objects, as `trust.json` has them, but for the scenario."""
        (scenario,) = self.comparison.scenarios
        return {
            "recording": self.recording,
            "model": self.estimate.model.name,
            "method": self.label,
            "replications": self.comparison.replications(),
            "parameters": self.parameters,
            "methods": {
                row.method: {
                    "loss": row.loss,
                    "loss_95": [row.loss_lower, row.loss_upper],
                    "coverage": row.coverage_95,
                    "verdict": judge(self.comparison.scored(scenario, row.method)).words,
                }
                for row in self.comparison.of(scenario).itertuples()
            },
            "sentences": self.sentences,
            "unknown": UNKNOWN,
        }


def _advice(method: str, known: Mapping[str, Any]) -> str:
    """What to do about an interval whose coverage is off."""
    low, high = (100.0 * end for end in known["coverage_95"])
    words = (
        f"{method}'s interval of {known['parameter']} covers {100.0 * known['coverage']:.0f} % "
        f"here ({low:.0f} to {high:.0f} %)"
    )
    if math.isnan(known["factor"]):
        return f"{words}; more simulations tell what its length should be."
    if math.isinf(known["factor"]):
        return f"{words}, and no length mends it."
    return f"{words}: multiply its length by {known['factor']:.2g}."


def try_fit(
    recording: Recording,
    model: PilotModel,
    tried: Iterable[Method | str],
    folder: Path,
    replications: int,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
) -> Trust:
    """Fit a recording, and compare methods on simulations of the fit.

    Parameters
    ----------
    recording, model
        The recording, and the model to fit.
    tried
        Methods; the fit by the first is judged. None for all, and ``mle``.
    folder
        Where the study and `trust.json` are; what was done there is not done again.
    replications, seed
        Simulations, and the seed of all random numbers.
    workers
        Processes; None for one for each processor.

    Raises
    ------
    InputError
        If the fit failed, `scenario_of_estimate` refuses it, or the folder holds another trial.
    """
    require_scenario(model)
    named = [method_named(m) if isinstance(m, str) else m for m in tried]
    estimate, simulated = fits_of(recording, model, named[:1], seed)
    scenario = scenario_of_estimate(simulated, recording)
    make_folder(folder)
    path, origin = folder / TRUST, list[AnyScenario | str]([scenario])
    facts: dict[str, object] = {"seed": seed}
    if MODELS.get(scenario.model.name) == scenario.model:  # otherwise no file can name the model
        facts["scenario"] = scenario_json(scenario)
        if path.exists() and designed_scenario(path) != scenario:
            raise InputError(
                f"{path}: is of another recording, model or method; name another folder with --out"
            )
        write_file(path, strict_json(facts).encode())
        origin = [str(path)]
    study = Study(origin, named or list(METHODS.values()), replications, seed)
    label = label_of(named[0]) if named else DEFAULT_METHOD
    comparison = study.run_in(folder, workers)
    trust = Trust(recording.source, estimate, label, simulated.specification, comparison)
    write_file(path, strict_json({**trust.to_dict(), **facts}).encode())
    return trust


def fits_of(
    recording: Recording, model: PilotModel, method: Sequence[Method] = (), seed: int = DEFAULT_SEED
) -> tuple[Estimate, Estimate]:
    """The fit of a recording that is judged, and the one that is simulated.

    They are one where the method, ``mle`` if none is given, estimates the remnant; otherwise
    the fit by ``mle`` is simulated.

    Raises
    ------
    InputError
        If the fit failed.
    """
    usual = method_named(DEFAULT_METHOD)
    (first,) = method or (usual,)
    label = label_of(first)
    estimate = identify(first, recording, model, fit_rng(seed, label))
    if not estimate.outcome.usable:
        raise InputError(f"{recording.source}: {label}: {estimate.sentence}; nothing to simulate")
    if estimate.remnant is not None:
        return estimate, estimate
    return estimate, identify(usual, recording, model, fit_rng(seed, DEFAULT_METHOD))


# --------------------------------------------------------------------- the scenario of an estimate


def require_scenario(model: PilotModel) -> None:
    """Refuse a model that no scenario of an estimate can have, before any work is done."""
    if model.changes or model.extra:
        why = "varies in time or acts on further signals, which no scenario does; name another"
        raise InputError(f"model {model.name} {why}")


def scenario_of_estimate(estimate: Estimate, recording: Recording) -> Scenario:
    """The scenario of a recording: what would be recorded if its estimate were the truth.

    The forcing functions are those that were recorded, the remnant has the estimated
    spectrum, and the recorder adds as much to e and x as was found there.

    Parameters
    ----------
    estimate
        A fit whose method estimates the remnant, such as ``mle``.
    recording
        The recording that was fitted.

    Raises
    ------
    InputError
        If the fit failed or has no remnant; if the pilot varies in time, no controlled
        element is known, or the loop of the two is unstable; if the forcing functions differ
        from run to run.
    """
    model, source = estimate.model, recording.source
    element: ControlledElement | None = None
    if not estimate.outcome.usable or estimate.remnant is None:
        why = "it has no remnant" if estimate.outcome.usable else estimate.sentence
    else:
        require_scenario(model)
        element = stabilised_element(recording, model, estimate.values)
        why = element_unknown(recording) or "its loop is unstable: check the signs of the signals"
    if element is None or estimate.remnant is None:
        raise InputError(f"{source}: the fit by {estimate.method} cannot be simulated: {why}")

    def to_control(omega: FloatArray) -> FloatArray:
        loop = element.response(omega) * sum(pilot_on(model, omega, estimate.values))
        return np.asarray(1.0 / np.abs(1.0 + loop) ** 2)

    stem = name_of(Path(source).stem).strip(".")
    return checked(
        Scenario(
            f"like-{stem or 'recording'}"[:100],
            f"pilots like that of {source}, as {estimate.method} fits it",
            model,
            tuple(estimate.values.tolist()),
            # Methods have to find what the recording does not name.
            element if recording.controlled_element else replace(element, name=""),
            recorded_forcing(recording, "ft"),
            recorded_forcing(recording, "fd"),
            recorded_remnant(estimate.remnant, recording, to_control),
            duration=recording.duration,
            run_in=recording.run_in * recording.dt,
            dt=recording.dt,
            runs=recording.runs,
            recorder=recorded_noise(recording),
            units=tuple(recording.units.items()),
        )
    )


def fitted_scenario(fitted: Fitted) -> dict[str, Any] | None:
    """What would be recorded if a fit were the truth, as `scenario_json` has it.

    None where no estimate can be simulated, or where the file cannot hold its scenario.
    """
    if not known_lines(fitted.recording):
        return None
    recording = fitted.loop_element.named_in(fitted.recording)
    for estimate in fitted.estimates:
        # Starts and bounds of the search are none of the pilot's.
        model = replace(estimate.model, overrides=())
        with suppress(InputError):
            return scenario_json(scenario_of_estimate(replace(estimate, model=model), recording))
    return None


def recorded_forcing(recording: Recording, name: str) -> Multisine | None:
    """A forcing function of a recording, None where there is none.

    One without whole periods in the window is a sum of sines too, over a period a little longer
    than the recording.

    Parameters
    ----------
    recording
        The recording; a target that was not recorded is e + x.
    name
        ``ft`` or ``fd``.

    Raises
    ------
    InputError
        If it differs from run to run.
    """
    signal = recording.input("ft") if name == "ft" else recording.fd
    if signal is None or rms(signal) <= 1e-9 * rms(recording.e if name == "ft" else recording.u):
        return None
    mean = np.mean(signal, axis=0)
    if rms(signal - mean) > SAME_SIGNAL * rms(mean):
        raise InputError(
            f"{recording.source}: {name} differs from run to run, so that its runs have no common "
            "scenario; give one run, or runs with the same forcing functions"
        )
    if (lines := known_lines(recording).get(name)) is not None:
        window = mean[recording.run_in :]
        sines = _sines(window, recording.dt, 0.0, lines)
        if rms(sines.at(recording.time) + window.mean() - mean) <= SAME_SIGNAL * rms(mean):
            return sines
    turn = np.linspace(0.0, math.pi, round(RETURN_SECONDS / recording.dt), endpoint=False)[1:]
    back = mean[-1] + (mean[0] - mean[-1]) * 0.5 * (1.0 - np.cos(turn))
    return _sines(np.append(mean, back), recording.dt, float(recording.time[0]))


def _sines(signal: FloatArray, dt: float, begin: float, lines: IntArray | None = None) -> Multisine:
    """A sampled period that begins at a time [s], without its mean: at lines, or all that count."""
    phasors = 2j * np.fft.rfft(signal)[1 : (signal.size + 1) // 2] / signal.size
    if lines is None:
        lines = 1 + np.flatnonzero(np.abs(phasors) >= SMALLEST_LINE * np.abs(phasors).max())
    kept = phasors[lines - 1] * np.exp(-2j * math.pi * lines * begin / (signal.size * dt))
    size, phase = np.abs(kept).tolist(), np.angle(kept).tolist()
    return Multisine(tuple(lines.tolist()), tuple(size), tuple(phase), signal.size * dt)


def recorded_remnant(
    remnant: RemnantEstimate, recording: Recording, to_control: Callable[[FloatArray], FloatArray]
) -> TabulatedRemnant:
    """The remnant by its estimated spectrum; above the band by that of the recorded control.

    Parameters
    ----------
    remnant
        The estimate.
    recording
        The recording.
    to_control
        Power of the control for each unit of the remnant's, at frequencies [rad/s].
    """
    floors, nyquist = floors_of(recording), 1.001 * math.pi / recording.dt
    above = floors.omega > remnant.omega[-1]
    omega = np.concatenate([remnant.omega, floors.omega[above]])
    beyond = floors.power["u"][above] / to_control(floors.omega[above])
    density = np.concatenate([remnant.density, beyond])
    density = np.maximum(density, 1e-12 * density.max())
    return TabulatedRemnant(
        omega=(*omega.tolist(), nyquist),
        density=(*density.tolist(), float(density[-1])),
        coefficients=len(remnant.parameters),
        band=float(remnant.omega[-1]),
    )


def recorded_noise(recording: Recording) -> Recorder | None:
    """A recorder with the floors of e and x; that of u is part of the remnant's spectrum."""
    floor, nyquist = floors_of(recording).floor, math.pi / recording.dt
    made = rms(recording.e + recording.x - recording.input("ft")) < FAINT * rms(recording.e)
    made = made and recording.ft is not None
    error, output = (
        math.sqrt(floor[name] * nyquist) / max(rms(getattr(recording, name)), 1e-300)
        for name in ("e", "x")
    )
    noise = (0.0 if made or error < FAINT else error, 0.0, 0.0 if output < FAINT else output)
    return Recorder(noise=noise, makes_error=made) if any(noise) else None
