"""Filters that whiten, and the products of lagged signals that tell the power they leave."""

from __future__ import annotations

import numpy as np

from pilotid.types import FloatArray

#: Samples that a whitening filter may reach back, and that one may to whom low frequencies matter.
REACH, FAR = 20, 60


def filters_and_slopes(
    autocovariance: FloatArray, slopes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Prediction-error filters of autocovariances, and their derivatives.

    Parameters
    ----------
    autocovariance
        Lags from 0, shape (sets, lags).
    slopes
        Its derivatives, shape (parameters, sets, lags).
    """
    order = autocovariance.shape[1] - 1
    lags = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    inverse = np.linalg.inv(autocovariance[:, lags])
    taps = np.ones_like(autocovariance)
    taps[:, 1:] = -(inverse @ autocovariance[:, 1:, None])[..., 0]
    derivatives = np.zeros((len(taps), len(slopes), order + 1))
    right = slopes[..., 1:, None] + slopes[..., lags] @ taps[:, 1:, None]
    derivatives[:, :, 1:] = np.swapaxes(-(inverse @ right)[..., 0], 0, 1)
    return taps, derivatives


def prediction_error_filters(autocovariance: FloatArray) -> FloatArray:
    """Prediction-error filters by Levinson's and Durbin's recursion, shape (sets, lags).

    Parameters
    ----------
    autocovariance
        Lags from 0, shape (sets, lags).
    """
    sets, lags = autocovariance.shape
    taps = np.zeros((sets, lags))
    taps[:, 0] = 1.0
    power = autocovariance[:, 0].copy()
    for order in range(1, lags):
        across = np.einsum("sk,sk->s", taps[:, :order], autocovariance[:, order:0:-1])
        reflection = -across / power
        taps[:, 1 : order + 1] += reflection[:, None] * taps[:, order - 1 :: -1][:, :order]
        power = power * (1.0 - reflection * reflection)
    return taps


def shifted_products(first: FloatArray, change: FloatArray) -> FloatArray:
    """Inner products of a signal with itself at all pairs of lags.

    Those of one pair of lags differ from those of the pair before by the samples at both ends
    alone.

    Parameters
    ----------
    first
        Products of lag 0 with lags 0 to n, shape (..., n + 1).
    change
        Products of the samples gained less those of the samples lost, shape (..., n, n).

    Returns
    -------
    Array of shape (..., n + 1, n + 1).
    """
    products = np.empty((*first.shape, first.shape[-1]))
    products[..., 0, :] = products[..., 0] = first
    for lag in range(change.shape[-1]):
        products[..., lag + 1, 1:] = products[..., lag, :-1] + change[..., lag, :]
    return products
