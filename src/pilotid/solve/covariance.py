"""The covariance of a least-squares estimate, whether its residual is white or not.

With A the Hessian of half the sum of squares and B the covariance of its gradient, the
estimate has the covariance A^-1 B A^-1, whatever the residual is (Ljung, System
Identification, 2nd ed., sec. 9.2).  The inverse of A alone holds for a white residual only.
"""

from __future__ import annotations

import numpy as np

from pilotid.solve.least_squares import Gram
from pilotid.support.numbers import Z95
from pilotid.support.types import BoolArray, FloatArray

#: Ratio of the smallest to the largest eigenvalue below which rounding decides.
SINGULAR = 1e-13


def covariance_of(hessian: FloatArray, variance: float) -> FloatArray | None:
    """Inverse of a least-squares information matrix, or None if it is singular.

    Parameters
    ----------
    hessian
        Inner products J'J, shape (parameters, parameters).
    variance
        Variance of the white residual.
    """
    found = _scaled_inverse(hessian)
    if found is None:
        return None
    inverse, scale = found
    return np.asarray(variance * inverse / np.outer(scale, scale))


def covariance_at_bounds(
    hessian: FloatArray, bounded: BoolArray, intervals: FloatArray
) -> FloatArray | None:
    """Covariance of an estimate of which some parameters lie at bounds, None if it is singular.

    There the inverse of the information tells nothing: it lets the parameters pass their
    bounds.  Standard errors are those of which the profile intervals would be 3.92; correlations
    are those of the parameters inside, given the others.

    Parameters
    ----------
    hessian
        Inner products J'J, shape (parameters, parameters).
    bounded
        Which parameters lie at a bound, shape (parameters,).
    intervals
        95 % profile-likelihood intervals, shape (parameters, 2).
    """
    conditional = np.where(bounded[:, None] | bounded, np.diag(np.diag(hessian)), hessian)
    found = _scaled_inverse(conditional)
    error = np.diff(intervals, axis=1)[:, 0] / (2.0 * Z95)
    if found is None or not (error > 0.0).all():
        return None
    scaled, _ = found
    size = np.sqrt(np.diag(scaled))
    return np.asarray(scaled * np.outer(error / size, error / size))


def _scaled_inverse(matrix: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Inverse of a matrix scaled to a unit diagonal, and the scale; None if it is singular."""
    diagonal = np.diag(matrix)
    if not (np.all(np.isfinite(matrix)) and np.all(diagonal > 0.0)):
        return None
    scale = np.sqrt(diagonal)
    eigenvalues, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if eigenvalues[0] <= SINGULAR * eigenvalues[-1]:
        return None
    return (vectors / eigenvalues) @ vectors.T, scale


#: Longest time over which scores are taken to be correlated [s].
REACH = 5.0


def sandwich_of(curvature: FloatArray, score_covariance: FloatArray) -> FloatArray | None:
    """The sandwich covariance A^-1 B A^-1, or None if A is not positive definite.

    Parameters
    ----------
    curvature
        A, shape (parameters, parameters).
    score_covariance
        B, of the same shape.
    """
    found = _scaled_inverse(curvature)
    if found is None:
        return None
    inverse, scale = found
    half = inverse / scale
    covariance = half @ score_covariance @ half.T / np.outer(scale, scale)
    return np.asarray(0.5 * (covariance + covariance.T))


def hessian(gram: Gram, values: FloatArray, step: float = 1e-4) -> FloatArray:
    """Hessian of half the sum of squares, from differences of its exact gradient.

    J'J leaves out the residual times the model's curvature, which matters where the
    residual is large.

    Parameters
    ----------
    gram
        Gram matrices of the problem.
    values
        Where, shape (parameters,).
    step
        Step of the central differences, as a share of each value.
    """
    steps = np.diag(step * np.maximum(np.abs(values), 1e-3))
    gradients = -gram(np.concatenate([values + steps, values - steps]))[:, :-1, -1]
    ahead, behind = np.split(gradients, 2)
    rows = (ahead - behind) / (2.0 * np.diag(steps))[:, None]
    return np.asarray(0.5 * (rows + rows.T))


def score_products(rows: FloatArray, reach: int) -> FloatArray:
    """Covariance of the sum of the scores, Jacobian times residual, over all samples.

    Products of scores up to `reach` samples apart, weighted by Parzen's lag window, which
    keeps the result positive semidefinite (Newey and West 1987; Andrews 1991).  Runs are
    independent.

    Parameters
    ----------
    rows
        Jacobian and, last, residual, shape (parameters + 1, runs, samples).
    reach
        Longest lag [samples].
    """
    scores = rows[:-1] * rows[-1]
    half = 1 << (scores.shape[2] + reach).bit_length() - 1  # transforms of other lengths are slow
    share = np.minimum(np.arange(half + 1) / (reach + 1.0), 1.0)
    window = np.where(share < 0.5, 1.0 - 6.0 * share**2 + 6.0 * share**3, 2.0 * (1.0 - share) ** 3)
    smoothing = np.fft.hfft(window, n=2 * half)[: half + 1]
    smoothing[1:-1] *= 2.0  # bins stand for two, but for the first and the last
    spectra = np.fft.rfft(scores, n=2 * half)
    products = np.einsum("prn,qrn,n->pq", spectra, spectra.conj(), smoothing, optimize=True)
    return np.asarray(products.real / (2 * half))


def score_dispersion(rows: FloatArray, estimated: int, length: int) -> tuple[float, int]:
    """How much the scores of segments scatter: chi-squared if errors are as large as claimed.

    Parameters
    ----------
    rows
        Jacobian and, last, residual at the estimate, shape (parameters + 1, runs, samples).
    estimated
        Parameters that count, the first ones.
    length
        Samples of a segment, about; runs are cut into equal ones.

    Returns
    -------
    The statistic and its degrees of freedom; 0, 0 for fewer than two segments.
    """
    _, runs, samples = rows.shape
    pieces = max(1, round(samples / length))
    if runs * pieces < 2:
        return 0.0, 0
    whole = rows[..., : samples // pieces * pieces].reshape(len(rows), runs * pieces, -1)
    jacobian, errors = whole[:estimated].transpose(1, 0, 2), whole[-1]
    size = np.sqrt(np.mean(jacobian**2, axis=(0, 2), keepdims=True))
    known = size[0, :, 0] > 0.0
    jacobian = jacobian[:, known] / size[:, known]
    scores = np.einsum("kps,ks->kp", jacobian, errors)
    information = jacobian @ jacobian.transpose(0, 2, 1)
    # The whole score is zero but for what a likelihood adds evenly to what the segments know.
    share = np.linalg.lstsq(information.sum(axis=0), scores.sum(axis=0))[0]
    scores -= information @ share
    sizes, directions = np.linalg.eigh(information)
    along = np.einsum("kpq,kp->kq", directions, scores)
    # The mean of the diagonal is one a sample: what is known next to nothing of does not count.
    kept = sizes > 1e-4 * whole.shape[2]
    variance = float(np.mean(errors**2))
    statistic = float(np.sum(along[kept] ** 2 / sizes[kept])) / (variance or 1.0)
    return statistic, int(np.count_nonzero(kept)) - int(np.count_nonzero(known))
