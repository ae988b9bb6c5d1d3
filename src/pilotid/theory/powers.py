"""The information of an experiment as a function of the power of each forcing line.

While the remnant is held, the response to a line of power p adds p times a matrix of rank
two: the information is affine in the powers, and the covariance that it bounds is convex in
them (Fedorov, Theory of Optimal Experiments, 1972; Mehra, IEEE Trans. AC-19, 1974, for lines
of forcing functions).  Lines of one run must differ from one another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.solve.covariance import covariance_of
from pilotid.theory.bounds import nuisance_share
from pilotid.theory.experiment import Experiment, View
from pilotid.types import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class LineInformation:
    """Information on relative parameters: that of the remnant, and that of each line.

    Attributes
    ----------
    base
        Information of one run without forcing functions, the remnant's own parameters
        estimated too, shape (parameters, parameters).
    factors
        Information of a line of unit power is F F', with F of shape (parameters, 2); shape
        (lines, parameters, 2).
    runs
        Runs with independent remnants.
    """

    base: FloatArray
    factors: FloatArray
    runs: int

    def information(self, powers: FloatArray) -> FloatArray:
        """The information at these powers [variance of each line's sine], shape (lines,)."""
        forced = np.einsum("j,jpa,jqa->pq", powers, self.factors, self.factors)
        return np.asarray(self.runs * (self.base + forced))

    def covariance(self, powers: FloatArray) -> FloatArray:
        """Bound on the covariance of relative errors; NaN where the information is singular.

        Parameters
        ----------
        powers
            Powers of the lines, shape (lines,).

        Returns
        -------
        FloatArray
            Shape (parameters, parameters).
        """
        found = covariance_of(self.information(powers), 1.0)
        return np.full_like(self.base, np.nan) if found is None else found

    def slopes(self, powers: FloatArray) -> FloatArray:
        """Derivatives of `covariance` by each line's power, the remnant held.

        Returns
        -------
        FloatArray
            Shape (lines, parameters, parameters).
        """
        seen = np.einsum("pq,jqa->jpa", self.covariance(powers), self.factors)
        return np.asarray(-self.runs * np.einsum("jpa,jqa->jpq", seen, seen))


def line_information(
    experiment: Experiment,
    omega: FloatArray,
    error: ComplexArray,
    output: ComplexArray,
    band: float | None = None,
) -> LineInformation:
    """What lines tell of the parameters of an experiment; its own lines are left aside.

    Parameters
    ----------
    experiment
        The loop and its remnant.
    omega
        Frequencies of the lines [rad/s], shape (lines,); the same frequency may be there
        twice if the lines do not meet in one run.
    error, output
        Error and output for each unit of a line, shape (lines,).
    band
        What lies above this frequency [rad/s] is not used; None for the whole record.
    """
    view = View(experiment, band)
    circulation = view.circulation
    free = view.gradient(view.omega, circulation.error, circulation.output, experiment.values)
    base = view.samples * (view.information(free, free) - nuisance_share(view, free))
    phasors = view.gradient(omega, error, output, experiment.values)
    phasors = phasors / np.sqrt(experiment.circulation(omega).density / experiment.samples)
    phasors = np.where(omega < view.band, phasors, 0.0)
    factors = np.stack([phasors.real.T, phasors.imag.T], axis=-1)
    values = experiment.values
    return LineInformation(
        base * np.outer(values, values), factors * values[:, None], experiment.runs
    )
