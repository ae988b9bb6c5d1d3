"""Weighted least squares at the lines of the forcing functions: a method in a package of its own.

At every line of a multisine the control is U = H E + N, with the pilot H and the remnant N (for
several channels, the sum of each response times its input).  Divided by E that is the describing
function U/E, to which models of pilots have been fitted since McRuer & Jex, *A Review of
Quasi-Linear Pilot Models*, IEEE Trans. Human Factors in Electronics 8(3), 1967.  Here the
parameters are fitted to U itself, each line weighted by the power of the remnant in the bins
beside it, which the fit tells in two rounds.

Assumes whole periods of the forcing in the window, and a pilot who does not change.

When not to use it: for results.  What transients leak to the lines stays in, and so does the
remnant in E, which makes the fit tend to the inverse of the controlled element where the remnant is
strong; `fourier` of pilotid has cures for both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pilotid.estimate.applicability import lines_objection
from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.likelihood.estimates import make_estimate
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import forcing_lines
from pilotid.solve.covariance import covariance_of
from pilotid.solve.least_squares import Problem, minimise, search


class Lines(Problem):
    """U less what the channels make of their inputs, over the remnant's size, by line and run."""

    def __init__(self, recording: Recording, model: PilotModel, bins: np.ndarray) -> None:
        self.model, self.omega = model, 2.0 * np.pi * bins / recording.duration
        self.control = coefficients(recording, recording.u, bins)
        inputs = [c.sign * coefficients(recording, recording.input(c.on), bins)
                  for c in model.channels]  # fmt: skip
        self.inputs = np.array(inputs)  # shape (channels, runs, bins)
        self.weight = 1.0 / np.mean(np.abs(self.control), axis=0)

    @property
    def residuals(self) -> int:
        """Number of real residuals."""
        return 2 * self.control.size

    def left(self, values: np.ndarray) -> np.ndarray:
        """The control that is not explained, shape (runs, bins)."""
        return self.control - np.einsum("cn,crn->rn", self.model.response(self.omega, values),
                                        self.inputs)  # fmt: skip

    def rows(self, values: np.ndarray) -> np.ndarray:
        """Jacobian and below it the residual, shape (sets, parameters + 1, residuals)."""
        responses, slopes = self.model.response_and_jacobian(self.omega, values)
        every = np.concatenate([slopes, responses[:, :, None]], axis=2)
        rows = np.einsum("scpn,crn->sprn", every, self.inputs)
        rows[:, -1] = self.control - rows[:, -1]
        flat = (rows * self.weight).reshape(*rows.shape[:2], -1)
        return np.concatenate([flat.real, flat.imag], axis=-1)


def coefficients(recording: Recording, signal: np.ndarray, bins: np.ndarray) -> np.ndarray:
    """Fourier coefficients of the measurement window, shape (runs, bins)."""
    return np.asarray(np.fft.rfft(recording.window(signal))[:, bins] / recording.samples)


@dataclass(frozen=True)
class LineFit:
    """Least squares at the forcing lines, weighted by the remnant beside them.

    Attributes
    ----------
    neighbours
        Bins beside each line, half of them on either side, that tell the remnant's power.
    """

    neighbours: int = 16
    name: ClassVar[str] = "line-fit"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why the forcing functions have no lines, or too few, for the model's channels."""
        return lines_objection(recording, model)

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Fit twice, the second time with the weights that the first one tells."""
        lines = np.sort(np.concatenate(list(forcing_lines(recording).values())))
        between = np.setdiff1d(np.arange(1, recording.samples // 2), lines)
        apart = np.abs(between[:, None] - lines)
        beside = between[np.argsort(apart, axis=0, kind="stable")[: self.neighbours]]
        problem = Lines(recording, model, lines)
        end = search(problem.gram, model, rng, candidates=24, refined=3)
        others = Lines(recording, model, beside.ravel())
        remnant = np.abs(others.left(end.values[0])) ** 2
        power = np.mean(remnant.reshape(-1, *beside.shape), axis=(0, 1))
        problem.weight = 1.0 / np.sqrt(power + 1e-24 * np.max(np.abs(problem.control)) ** 2)
        minimum = minimise(problem.gram, end.values[:1], model)
        freedom = problem.residuals - len(model.parameters)
        gram = minimum.gram[0]
        covariance = covariance_of(gram[:-1, :-1], float(minimum.cost[0]) / max(freedom, 1))
        if covariance is None:
            return failed(self.name, model, Outcome.SINGULAR)
        converged = bool(minimum.converged[0])
        values = minimum.values[0]
        return make_estimate(self.name, recording, model, values, covariance, converged=converged)
