"""What output error with a white residual ends at in long recordings: an oracle of the tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.bounds import Circulation, Experiment, View, signed
from pilotid.solve.covariance import hessian, sandwich_of
from pilotid.solve.least_squares import minimise
from pilotid.support.types import ComplexArray, FloatArray, InputError


@dataclass(frozen=True, eq=False)
class WhiteLimit:
    """Output error with a residual taken for white, in the limit of a long recording.

    Attributes
    ----------
    values
        Where the estimate goes, shape (parameters,).
    bias
        The same less the truth.
    claimed
        The covariance that the method reports, shape (parameters, parameters).
    sandwich
        The covariance that it has.
    """

    values: FloatArray
    bias: FloatArray
    claimed: FloatArray
    sandwich: FloatArray


def white_limit(experiment: Experiment, band: float | None = None) -> WhiteLimit:
    """Bias, claimed covariance and true covariance of output error with a white residual.

    The minimum is the one that is reached from the truth.

    Parameters
    ----------
    experiment
        The loop and its excitation, which must be periodic.
    band
        Analysis band [rad/s]; None for the full sampling rate.

    Raises
    ------
    InputError
        If the excitation is not periodic: a single transient has no limit for long
        recordings, since its share of the record vanishes.
    """
    if experiment.transient is not None:
        raise InputError("the limit of long recordings needs a periodic excitation, not a step")
    view = View(experiment, band)

    def gram(sets: FloatArray) -> FloatArray:
        return np.array([mean_products(view, values) for values in sets])

    end = minimise(gram, experiment.values[None], experiment.model, tolerance=1e-13, iterations=300)
    values, terms = end.values[0], end.gram[0]
    claimed = np.linalg.inv(view.samples * terms[:-1, :-1] / terms[-1, -1])
    sandwich = sandwich_of(hessian(gram, values), score_covariance(view, values) / view.samples)
    if not end.converged[0] or sandwich is None:
        raise InputError("the expected cost has no proper minimum near the true parameters")
    return WhiteLimit(
        values,
        values - experiment.values,
        claimed / experiment.runs,
        sandwich / experiment.runs,
    )


def missed(
    view: View, omega: FloatArray, error: ComplexArray, output: ComplexArray, values: FloatArray
) -> ComplexArray:
    """What the true pilot answers to these inputs less the predicted answer, shape (n,)."""
    model, truth = view.experiment.model, view.experiment.values
    difference = model.response(omega, truth) - model.response(omega, values)
    return np.asarray(np.sum(difference * signed(model, error, output), axis=0))


def remnant_rows(
    view: View, omega: FloatArray, circulation: Circulation, values: FloatArray
) -> ComplexArray:
    """Gradient of the prediction and, last, the residual, for each unit of remnant."""
    given = omega, circulation.error, circulation.output, values
    return np.vstack([view.gradient(*given), 1.0 + missed(view, *given)])


def line_rows(view: View, values: FloatArray) -> ComplexArray:
    """Phasors, at the lines, of the gradient of the prediction and, last, the residual."""
    given = view.line_omega, view.line_error, view.line_output, values
    return np.vstack([view.gradient(*given), missed(view, *given)])


def mean_products(view: View, values: FloatArray) -> FloatArray:
    """Expected products of the gradient's and the residual's samples, after decimation."""
    free = remnant_rows(view, view.omega, view.circulation, values)
    free = free * np.sqrt(view.share * view.circulation.density)
    forced = line_rows(view, values)
    return np.asarray(view.products(free, free) + 0.5 * np.real(forced @ forced.conj().T))


def score_covariance(view: View, values: FloatArray) -> FloatArray:
    """Long-run covariance of gradient times residual, for a Gaussian remnant.

    The fourth moments of the circulating remnant follow from its second ones
    (Isserlis); a line's phasors multiply what the remnant does at its frequency.
    """
    free = remnant_rows(view, view.omega, view.circulation, values)
    direct = view.share * view.circulation.density * np.abs(free[-1]) * free[:-1]
    crossed = view.share * view.circulation.density * free[-1].conj() * free[:-1]
    forced = line_rows(view, values)
    free = remnant_rows(view, view.line_omega, view.at_lines, values)
    mixed = forced[:-1].conj() * free[-1] + forced[-1].conj() * free[:-1]
    mixed = mixed * np.sqrt(0.5 * view.share * view.at_lines.density)
    return np.asarray(
        view.products(direct, direct)
        + view.products(crossed, crossed.conj())
        + np.real(mixed @ mixed.conj().T)
    )
