"""Continuation of signals beyond both ends of a recording."""

from __future__ import annotations

from math import factorial

import numpy as np

from pilotid.types import FloatArray


def _extended(signal: FloatArray, edges: FloatArray, extension: int, dt: float) -> FloatArray:
    """Continue a signal beyond both ends, faded to zero.

    Parameters
    ----------
    signal
        The signal, shape (runs, samples).
    edges
        What it is the derivative of, at the first and last sample, from the lowest
        derivative upwards; shape (derivative, 2, runs), empty for a signal itself.
    extension
        Samples to add at each end.
    dt
        Sampling interval [s].
    """
    order = len(edges)
    # Going back in time, odd derivatives change their sign.
    signs = (-1.0) ** np.arange(order + 1)
    lower = signs[:order, None] * edges[:, 0]
    left = signs[order] * _continued(signs[order] * signal, lower, extension, dt)
    right = _continued(signal[:, ::-1], edges[:, 1], extension, dt)
    return np.concatenate([left[:, ::-1], signal, right], axis=1)


def _continued(inward: FloatArray, lower: FloatArray, extension: int, dt: float) -> FloatArray:
    """Continuation of a signal beyond its first sample, in the direction away from it.

    Odd reflection, since a jump would ring into the scored part, where whitening
    magnifies it.  The continuation of a derivative (an acceleration, say) must moreover
    bring the signal underneath to rest from where the recording shows it: slow dynamics
    (canals) would otherwise start from a state that the recording contradicts.

    Parameters
    ----------
    inward
        The signal from its end inwards, shape (runs, samples).
    lower
        Lower derivatives at the end, in outward time, shape (derivative, runs).
    extension
        Samples to add.
    dt
        Sampling interval [s].
    """
    time = np.arange(1, extension + 1) * dt
    span = time[-1] + dt
    fade = 0.5 * (1.0 + np.cos(np.pi * time / span))
    outward = (2.0 * inward[:, :1] - inward[:, 1 : extension + 1]) * fade
    order = len(lower)
    if order == 0:
        return np.asarray(outward)
    # f^(order-j)(span) = sum_i f^(order-j+i)(0) span^i/i! + int (span-t)^(j-1)/(j-1)! f^(order)
    kernels = np.array([(span - time) ** (j - 1) / factorial(j - 1) for j in range(1, order + 1)])
    bumps = np.sin(np.pi * time / span) ** 2 * (time / span) ** np.arange(order)[:, None]
    at_rest = np.zeros((order, inward.shape[0]))
    for j in range(1, order + 1):
        start = sum(lower[order - j + i] * span**i / factorial(i) for i in range(j))
        half = 0.5 * span ** (j - 1) / factorial(j - 1) * inward[:, 0]
        at_rest[j - 1] = -start - dt * (outward @ kernels[j - 1] + half)
    weights = np.linalg.solve(dt * kernels @ bumps.T, at_rest)
    return np.asarray(outward + weights.T @ bumps)


def fast_length(samples: int) -> int:
    """The shortest length of a fast real transform, a product of 2, 3 and 5, of so many samples.

    scipy has the same as ``next_fast_len``, but takes longer to import than a fit takes.
    """
    best = 1 << max(samples - 1, 0).bit_length()
    five = 1
    while five < best:
        product = five
        while product < best:
            # By the smallest power of 2 that makes it long enough.
            best = min(best, product << max(-(-samples // product) - 1, 0).bit_length())
            product *= 3
        five *= 5
    return best
