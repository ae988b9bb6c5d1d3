"""Whether chains have converged, and how many independent draws they are worth.

Walkers of one ensemble move by one another's positions, so that agreement among them proves
nothing: whether a run has converged is judged across independent ensembles.
"""

from __future__ import annotations

import numpy as np

from pilotid.types import FloatArray

WINDOW = 5.0  # autocorrelation times over which correlations are summed (Sokal 1997)


def autocorrelation_times(chains: FloatArray) -> FloatArray:
    """Integrated autocorrelation times [steps], shape (parameters,).

    Correlations are averaged over all walkers (Goodman and Weare 2010), about the mean of
    all ensembles, so that ensembles which disagree have a long one.

    Parameters
    ----------
    chains
        Shape (ensembles, steps, walkers, parameters).
    """
    steps = chains.shape[1]
    offset = chains - chains.mean(axis=(0, 1, 2))
    length = 1 << (2 * steps - 1).bit_length()
    spectrum = np.fft.rfft(offset, n=length, axis=1)
    power = np.mean(spectrum.real**2 + spectrum.imag**2, axis=(0, 2))
    products = np.fft.irfft(power, n=length, axis=0)[:steps]
    products /= np.arange(steps, 0, -1)[:, None]
    times = np.ones(chains.shape[-1])
    for i, own in enumerate(products.T):
        if own[0] > 0.0:
            sums = 2.0 * np.cumsum(own / own[0]) - 1.0
            within = np.arange(steps) >= WINDOW * sums
            times[i] = max(1.0, sums[int(np.argmax(within)) if within.any() else -1])
    return times


def r_hat(chains: FloatArray) -> FloatArray:
    """Rank-normalised split R-hat across ensembles, shape (parameters,).

    The larger of that of the ranks and that of the ranks of distances from the median
    (Vehtari, Gelman, Simpson, Carpenter and Buerkner, Bayesian Analysis 16, 2021); each half
    of an ensemble's steps, with all its walkers, is a chain.

    Parameters
    ----------
    chains
        Shape (ensembles, steps, walkers, parameters).
    """
    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, half : 2 * half]])
    flat = halves.reshape(len(halves), -1, chains.shape[-1])
    folded = np.abs(flat - np.median(flat, axis=(0, 1)))
    return np.maximum(_split_r_hat(_normal_scores(flat)), _split_r_hat(_normal_scores(folded)))


def _normal_scores(flat: FloatArray) -> FloatArray:
    from scipy.special import ndtri

    chains, draws, count = flat.shape
    pooled = flat.reshape(-1, count)
    ranks = np.empty_like(pooled)
    order = np.argsort(pooled, axis=0)
    np.put_along_axis(ranks, order, np.arange(1.0, len(pooled) + 1.0)[:, None], axis=0)
    return np.asarray(ndtri((ranks - 0.375) / (len(pooled) + 0.25))).reshape(chains, draws, count)


def _split_r_hat(flat: FloatArray) -> FloatArray:
    draws = flat.shape[1]
    within = np.mean(np.var(flat, axis=1, ddof=1), axis=0)
    between = np.var(np.mean(flat, axis=1), axis=0, ddof=1)
    return np.asarray(np.sqrt((draws - 1.0) / draws + between / within))
