"""A closed loop as identification sees it: spectra instead of recordings.

Spectra are normalised so that sampled white noise of variance s^2 has density s^2: a
variance is the mean of a density from 0 to half the sampling rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pilotid.pilot.model import PilotModel
from pilotid.types import ComplexArray, FloatArray

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
    line_omega, line_error, line_output
        Frequencies [rad/s] of the periodic excitation, and the phasors of e and x there,
        shape (lines,).
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
    line_omega: FloatArray
    line_error: ComplexArray
    line_output: ComplexArray
    transient: FloatArray | None = None


def gradient_of(
    model: PilotModel,
    omega: FloatArray,
    error: ComplexArray,
    output: ComplexArray,
    values: FloatArray,
) -> ComplexArray:
    """Derivatives of the control that a model predicts for these inputs, shape (parameters, n)."""
    jacobian = model.response_and_jacobian(omega, values)[1]
    return np.asarray(np.einsum("cpn,cn->pn", jacobian, _signed(model, error, output)))


def _signed(model: PilotModel, error: ComplexArray, output: ComplexArray) -> ComplexArray:
    """Input of each channel with the channel's sign, shape (channels, n)."""
    by_name = {"error": error, "output": output, "target": error + output}
    return np.array([c.sign * by_name[c.input] for c in model.channels])


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
        inside = experiment.line_omega < self.band
        self.line_omega = experiment.line_omega[inside]
        self.line_error = experiment.line_error[inside]
        self.line_output = experiment.line_output[inside]
        self.at_lines = experiment.circulation(self.line_omega)

    def products(self, first: ComplexArray, second: ComplexArray) -> FloatArray:
        """Means over the band of all products of two sets of spectra."""
        return np.asarray(np.real(first * self.weights @ second.conj().T))

    def information(self, first: ComplexArray, second: ComplexArray) -> FloatArray:
        """Information per sample in what the remnant circulates, of two sets of its spectra.

        In a part of the frequencies the likelihood has the loop's term as well, see
        `pilotid.time_domain.band_likelihood`; what both tell is the product of real parts.
        """
        if self.share == 1.0:  # over all frequencies the term is nil
            return self.products(first, second)
        return np.asarray(2.0 * (first.real * self.weights) @ second.real.T)

    def gradient(
        self, omega: FloatArray, error: ComplexArray, output: ComplexArray, values: FloatArray
    ) -> ComplexArray:
        """Derivatives of the predicted control for these inputs, shape (parameters, n)."""
        return gradient_of(self.experiment.model, omega, error, output, values)

    def missed(
        self, omega: FloatArray, error: ComplexArray, output: ComplexArray, values: FloatArray
    ) -> ComplexArray:
        """What the true pilot answers to these inputs less the predicted answer, shape (n,)."""
        model, truth = self.experiment.model, self.experiment.values
        difference = model.response(omega, truth) - model.response(omega, values)
        return np.asarray(np.sum(difference * _signed(model, error, output), axis=0))

    def remnant_rows(
        self, omega: FloatArray, circulation: Circulation, values: FloatArray
    ) -> ComplexArray:
        """Gradient of the prediction and, last, the residual, for each unit of remnant."""
        given = omega, circulation.error, circulation.output, values
        return np.vstack([self.gradient(*given), 1.0 + self.missed(*given)])

    def line_rows(self, values: FloatArray) -> ComplexArray:
        """Phasors, at the lines, of the gradient of the prediction and, last, the residual."""
        given = self.line_omega, self.line_error, self.line_output, values
        return np.vstack([self.gradient(*given), self.missed(*given)])

    def mean_products(self, values: FloatArray) -> FloatArray:
        """Expected products of the gradient's and the residual's samples, after decimation."""
        free = self.remnant_rows(self.omega, self.circulation, values)
        free = free * np.sqrt(self.share * self.circulation.density)
        forced = self.line_rows(values)
        return np.asarray(self.products(free, free) + 0.5 * np.real(forced @ forced.conj().T))

    def score_covariance(self, values: FloatArray) -> FloatArray:
        """Long-run covariance of gradient times residual, for a Gaussian remnant.

        The fourth moments of the circulating remnant follow from its second ones
        (Isserlis); a line's phasors multiply what the remnant does at its frequency.
        """
        free = self.remnant_rows(self.omega, self.circulation, values)
        direct = self.share * self.circulation.density * np.abs(free[-1]) * free[:-1]
        crossed = self.share * self.circulation.density * free[-1].conj() * free[:-1]
        forced = self.line_rows(values)
        free = self.remnant_rows(self.line_omega, self.at_lines, values)
        mixed = forced[:-1].conj() * free[-1] + forced[-1].conj() * free[:-1]
        mixed = mixed * np.sqrt(0.5 * self.share * self.at_lines.density)
        return np.asarray(
            self.products(direct, direct)
            + self.products(crossed, crossed.conj())
            + np.real(mixed @ mixed.conj().T)
        )
