"""Bounds of scenarios: exact closed-loop spectra for `pilotid.datasets.bounds`, or linearisation.

A time-varying loop has no spectra.  But the prediction's derivatives by the parameters, at the
truth and whitened by the remnant's own spectrum, are the information of each recording; its mean
is Fisher's, since inputs hold nothing of the remnant that is still to come.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from pilotid.datasets.bounds import Circulation, Experiment, Inputs, gradient_of
from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.signals import Multisine, Steps
from pilotid.datasets.simulation import closed_loop, remnant_shaping, simulate, white_level
from pilotid.likelihood.prediction import predict
from pilotid.support.types import ComplexArray, FloatArray, InputError

RECORDINGS, SEED = 24, 20160501
BAND = 120.0  # rad/s, beyond which no pilot answers


def experiment_of(scenario: Scenario) -> Experiment:
    """The experiment that a scenario describes.

    Raises
    ------
    InputError
        If the loop is unstable, if there is no remnant, if a multisine and another kind of
        forcing function occur together, or if that other kind starts during the run-in.
    """
    level = _level(scenario)
    both = ((scenario.target, "target"), (scenario.disturbance, "disturbance"))
    forcing = [(f, cause) for f, cause in both if f is not None]
    sines = [(f, cause) for f, cause in forcing if isinstance(f, Multisine)]
    if scenario.changes or (sines and len(sines) < len(forcing)):
        raise InputError(
            f"scenario {scenario.name}: bounds for a multisine together with another kind of "
            "forcing function, or of what changes in time, are not implemented"
        )
    return Experiment(
        model=scenario.model,
        values=scenario.values,
        dt=scenario.dt,
        samples=round(scenario.duration / scenario.dt),
        runs=scenario.runs,
        circulation=lambda w: _circulation(scenario, level, w),
        lines=_phasors(scenario, sines),
        transient=_transient(scenario) if len(forcing) > len(sines) else None,
    )


def _level(scenario: Scenario) -> float:
    if level := white_level(scenario):
        return level
    raise InputError(f"scenario {scenario.name}: without a remnant every bound is zero")


def _phasors(scenario: Scenario, sines: Sequence[tuple[Multisine, str]]) -> Inputs:
    """Frequencies of the lines, and the phasors of e and x there.

    A line that both causes have is one line, and phases count.
    """
    each = [(np.zeros(0), np.zeros(0, dtype=complex), np.zeros(0, dtype=complex))]
    for f, cause in sines:
        phasors = np.array(f.amplitudes) * np.exp(1j * np.array(f.phases))
        _, e, x = inputs_of(scenario, f.omega, cause)
        each.append((f.omega, e * phasors, x * phasors))
    omega, error, output = (np.concatenate(parts) for parts in zip(*each, strict=True))
    lines, at = np.unique(omega, return_inverse=True)
    sums = np.zeros((2, lines.size), dtype=complex)
    np.add.at(sums[0], at, error)
    np.add.at(sums[1], at, output)
    return lines, sums[0], sums[1]


def inputs_of(scenario: Scenario, omega: FloatArray, cause: str) -> Inputs:
    """Error and output for each unit of a cause: target, disturbance or remnant."""
    output = closed_loop(scenario, omega).x[cause]
    return omega, (1.0 if cause == "target" else 0.0) - output, output


def _circulation(scenario: Scenario, level: float, omega: FloatArray) -> Circulation:
    shaping = level * remnant_shaping(scenario, omega)
    _, error, output = inputs_of(scenario, omega, "remnant")
    return Circulation(error, output, np.abs(shaping) ** 2, scenario.remnant.log_slopes(omega))


def _transient(scenario: Scenario) -> FloatArray:
    """Derivatives of the forced control by the parameters, in the measurement window."""
    time = np.arange(round(scenario.duration / scenario.dt), dtype=float) * scenario.dt
    total = np.zeros((len(scenario.truth), time.size))
    for forcing, cause in ((scenario.target, "target"), (scenario.disturbance, "disturbance")):
        if forcing is None:
            continue
        if isinstance(forcing, Steps) and min(forcing.times) < 0.0:
            raise InputError(
                f"scenario {scenario.name}: bounds need a {cause} that is periodic or zero until "
                "the measurement window; this one starts before"
            )

        def response(omega: FloatArray, cause: str = cause) -> ComplexArray:
            return gradient_of(scenario.model, inputs_of(scenario, omega, cause), scenario.values)

        total += forcing.through(response, time)
    return total


@lru_cache(maxsize=64)
def bound_of(scenario: Scenario) -> FloatArray:
    """Standard errors that no unbiased method undercuts, the remnant's spectrum known.

    Parameters
    ----------
    scenario
        A scenario whose pilot or element changes.

    Returns
    -------
    FloatArray
        Shape (parameters,); nobody may change it.
    """
    level = _level(scenario)
    rng = np.random.default_rng(SEED)
    count = len(scenario.truth)
    information = np.zeros((count, count))
    for _ in range(RECORDINGS):
        prediction = predict(simulate(scenario, rng), scenario.model, BAND)
        shaping = level * remnant_shaping(scenario.constant_ends[0][0], prediction.s.imag)
        spectra = prediction.row_spectra(scenario.values[None])[0, :-1] / shaping
        rows = prediction.samples_of(spectra).reshape(count, -1)
        # White noise of variance 1 at the recording's samples has less at fewer of them.
        information += prediction.dt / scenario.dt * (rows @ rows.T) / RECORDINGS
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))
