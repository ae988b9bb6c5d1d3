"""The step of the neuromuscular system, for many parameter sets at once."""

from __future__ import annotations

import numpy as np

from pilotid.types import FloatArray

NODES = 3  # of the parabola that the input is, over a step


def muscle_step(
    frequency: FloatArray, damping: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Step of f^2/(s^2 + 2 d f s + f^2) with states output and rate.

    Returns
    -------
    Its matrix, shape (..., 2, 2), and what the input at start, middle and end of the step adds,
    shape (..., nodes, 2).
    """
    square, loss = frequency * frequency, damping * frequency
    turn = dt * dt * square * (damping * damping - 1.0)
    root = np.sqrt(np.abs(turn)) + 1e-12
    over = turn > 0.0
    reached = np.where(over, root, 0.0)
    # e^(-loss dt) cosh and sinh without overflow: loss dt >= root where it is overdamped.
    slow, fast = np.exp(reached - loss * dt), np.exp(-reached - loss * dt)
    even = np.where(over, 0.5 * (slow + fast), slow * np.cos(root))
    odd = np.where(over, 0.5 * (slow - fast), slow * np.sin(root)) * (dt / root)
    matrix = np.empty((*frequency.shape, 2, 2))
    matrix[..., 0, 0] = even + loss * odd
    matrix[..., 0, 1] = odd
    matrix[..., 1, 0] = -square * odd
    matrix[..., 1, 1] = even - loss * odd
    # Integrals of e^(A (dt - t)) B (t/dt)^j, each from the one before.
    lead, inverse = 2.0 * damping / frequency, 1.0 / square
    position = 1.0 - matrix[..., 0, 0]
    rate = -matrix[..., 1, 0]
    moments = [(position, rate)]
    for j in (1, 2):
        share = j / dt
        p, q = share * position, share * rate - square
        position, rate = -lead * p - inverse * q, p
        moments.append((position, rate))
    weights = np.empty((*frequency.shape, NODES, 2))
    for i in (0, 1):
        zeroth, first, second = (m[i] for m in moments)
        weights[..., 0, i] = zeroth - 3.0 * first + 2.0 * second
        weights[..., 1, i] = 4.0 * (first - second)
        weights[..., 2, i] = 2.0 * second - first
    return matrix, weights
