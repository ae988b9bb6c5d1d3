"""What an estimator can reach, from exact closed-loop spectra.

No simulation: the Cramer-Rao bound is the inverse of the Fisher information of the
whitened prediction error (Ljung, System Identification, 2nd ed., ch. 8 and 13).  All of it holds
for long recordings; edges, transients and the skewness of short ones are for Monte Carlo to show.

Spectra are normalised so that sampled white noise of variance s^2 has density s^2: a variance is
the mean of a density from 0 to half the sampling rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pilotid.model.model import PilotModel
from pilotid.support.numbers import covariance_of
from pilotid.support.types import ComplexArray, FloatArray

#: Frequencies [rad/s], and error and output there, each of shape (n,).
Inputs = tuple[FloatArray, ComplexArray, ComplexArray]
GRID = 8192  # steps of the frequency grid on which densities are integrated


class Circulation(NamedTuple):
    """What the loop makes of the remnant n, at some frequencies.

    Attributes
    ----------
    error, output
        Error e and output x for each unit of n, shape (n,).
    density
        Spectral density of n, shape (n,).
    log_slopes
        Derivatives of ln(density) by the remnant's own parameters, shape (parameters, n).
    """

    error: ComplexArray
    output: ComplexArray
    density: FloatArray
    log_slopes: FloatArray


@dataclass(frozen=True, eq=False)
class Experiment:
    """A closed loop, its excitation and its remnant, as far as identification sees them.

    Attributes
    ----------
    model, values
        The pilot and its true parameters in model order.
    dt, samples, runs
        Sampling interval [s], scored samples of a run, and runs with independent remnants.
    circulation
        Maps frequencies [rad/s] to what the remnant does in the loop.
    lines
        Frequencies of the periodic excitation, and the phasors of e and x there.
    transient
        Derivatives of the predicted control by the parameters for an excitation that is
        not periodic and starts from rest, shape (parameters, samples); None for none.
    """

    model: PilotModel
    values: FloatArray
    dt: float
    samples: int
    runs: int
    circulation: Callable[[FloatArray], Circulation]
    lines: Inputs
    transient: FloatArray | None = None


def gradient_of(model: PilotModel, inputs: Inputs, values: FloatArray) -> ComplexArray:
    """Derivatives of the control that a model predicts for these inputs, shape (parameters, n)."""
    jacobian = model.response_and_jacobian(inputs[0], values)[1]
    return np.asarray(np.einsum("cpn,cn->pn", jacobian, _signed(model, inputs)))


def _signed(model: PilotModel, inputs: Inputs) -> ComplexArray:
    """Input of each channel with the channel's sign, shape (channels, n)."""
    _, error, output = inputs
    by_name = {"e": error, "x": output, "ft": error + output}
    return np.array([c.sign * by_name[c.on] for c in model.channels])


class View:
    """An experiment inside a band, on a grid of frequencies."""

    def __init__(self, experiment: Experiment, band: float | None) -> None:
        nyquist = np.pi / experiment.dt
        self.experiment = experiment
        self.band = nyquist if band is None else min(band, nyquist)
        self.share = self.band / nyquist
        self.samples = experiment.samples * self.share  # after decimation to the band
        self.omega = np.linspace(0.0, self.band, GRID + 1)
        self.weights = np.full(GRID + 1, 1.0 / GRID)  # trapezoidal rule, of a mean
        self.weights[[0, -1]] *= 0.5
        self.circulation = experiment.circulation(self.omega)
        self.remnant = self.omega, self.circulation.error, self.circulation.output
        omega, error, output = experiment.lines
        inside = omega < self.band
        self.lines = omega[inside], error[inside], output[inside]
        self.at_lines = experiment.circulation(self.lines[0])

    def information(self, first: ComplexArray, second: ComplexArray) -> FloatArray:
        """Information per sample in what the remnant circulates, of two sets of its spectra.

        In a part of the frequencies the likelihood has the loop's term as well, see
        `pilotid.likelihood.band_likelihood`; what both tell is the product of real parts.
        """
        if self.share == 1.0:  # over all frequencies the term is nil
            return np.asarray(np.real(first * self.weights @ second.conj().T))
        return np.asarray(2.0 * (first.real * self.weights) @ second.real.T)


class Bounds(NamedTuple):
    """Lower bounds on the covariance of any unbiased estimator, (parameters, parameters).

    They are NaN where the information is singular.

    Attributes
    ----------
    full
        All of the record, the remnant's spectrum known.
    forcing
        The response to the forcing functions alone, as methods that look at the forcing
        lines only see it, the remnant's spectrum known.
    low_pass
        All of the record, with the remnant's own parameters estimated too.
    """

    full: FloatArray
    forcing: FloatArray
    low_pass: FloatArray


def bounds(*experiments: Experiment, band: float | None = None) -> Bounds:
    """Cramer-Rao bounds, of several experiments with one pilot together.

    Recordings have independent remnants, so that their informations add up, whatever the lines,
    amplitudes and phases of each.

    After a step the forced control holds more than a low-pass remnant up to any frequency,
    and the full-rate bound of a delay rests on what lies near half the sampling rate.  A
    method works inside a band; ask for the bound in that band then.

    Parameters
    ----------
    experiments
        The loops and their excitation, at least one.
    band
        What lies above this frequency [rad/s] is not used; None for the whole record.
    """
    informations = []
    for experiment in experiments:
        view = View(experiment, band)
        forcing, (free, shape) = _forcing_information(view), _remnant_information(view)
        full = forcing + view.samples * free
        informations.append(
            experiment.runs * np.array([full, forcing, full - view.samples * shape])
        )
    return Bounds(*map(_inverse, np.sum(informations, axis=0)))


def _remnant_information(view: View) -> tuple[FloatArray, FloatArray]:
    """Information per sample in the circulating remnant, and what its own parameters take of it."""
    gradient = gradient_of(view.experiment.model, view.remnant, view.experiment.values)
    by_shape, _ = monic(0.5 * view.circulation.log_slopes, 2 * GRID)
    cross = view.information(gradient, by_shape)
    taken = cross @ np.linalg.solve(view.information(by_shape, by_shape), cross.T)
    return view.information(gradient, gradient), np.asarray(taken)


def _forcing_information(view: View) -> FloatArray:
    """Information of one run's response to the forcing functions."""
    experiment = view.experiment
    phasors = gradient_of(experiment.model, view.lines, experiment.values)
    whitened = phasors / np.sqrt(view.at_lines.density)
    information = 0.5 * experiment.samples * np.real(whitened @ whitened.conj().T)
    if experiment.transient is None:
        return np.asarray(information)
    samples, dt = experiment.samples, experiment.dt
    # A causal filter and a signal that starts from rest: with zeros behind it, passage
    # through the transform is exact in the window.
    length = max(4 * samples, 2 * GRID)
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(length, dt), dtype=float)
    log_filter, log_gain = monic(0.5 * np.log(experiment.circulation(omega).density), length)
    spectrum = np.fft.rfft(experiment.transient, n=length) * np.exp(-log_gain - log_filter)
    bins = np.fft.fft(np.fft.irfft(spectrum, n=length)[:, :samples])
    bins = bins[:, np.abs(2.0 * np.pi * np.fft.fftfreq(samples, dt)) <= view.band]
    return np.asarray(information + np.real(bins @ bins.conj().T) / samples)


def monic(log_amplitude: FloatArray, length: int) -> tuple[ComplexArray, FloatArray]:
    """Logarithm of monic minimum-phase filters with given amplitudes.

    Parameters
    ----------
    log_amplitude
        ln|H| at the bins of a real transform, shape (..., length // 2 + 1).
    length
        Length of the transform.

    Returns
    -------
    The logarithms at the bins, and those of the gains left out to make the filters monic.
    """
    cepstrum = np.fft.irfft(log_amplitude, n=length)
    # Twice the causal half: the anticausal half folded over.
    cepstrum[..., 1 : (length + 1) // 2] *= 2.0
    cepstrum[..., length // 2 + 1 :] = 0.0
    gain = cepstrum[..., 0].copy()
    cepstrum[..., 0] = 0.0
    return np.fft.rfft(cepstrum), gain


def _inverse(information: FloatArray) -> FloatArray:
    covariance = covariance_of(information, 1.0)
    return np.full_like(information, np.nan) if covariance is None else covariance


def line_information(experiment: Experiment, lines: Inputs) -> tuple[FloatArray, FloatArray]:
    """What the remnant and lines of unit power tell of relative parameters, in all runs.

    The information without forcing functions, the remnant's own parameters estimated too, shape
    (parameters, parameters); and what each line adds, shape (lines, parameters, parameters).

    Parameters
    ----------
    experiment
        The loop and its remnant; its own lines are left aside.
    lines
        Frequencies of the lines, and error and output for each unit of a line; the same frequency
        may be there twice if the lines do not meet in one run.
    """
    view, values = View(experiment, None), experiment.values
    free, taken = _remnant_information(view)
    base = experiment.runs * view.samples * (free - taken) * np.outer(values, values)
    phasors = gradient_of(experiment.model, lines, values) * values[:, None]
    phasors = phasors / np.sqrt(experiment.circulation(lines[0]).density / experiment.samples)
    inside = np.where(lines[0] < view.band, phasors, 0.0 + 0.0j)
    return base, experiment.runs * np.real(np.einsum("pn,qn->npq", inside, inside.conj()))
