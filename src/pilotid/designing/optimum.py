"""Powers of lines that minimise relative errors within linear limits: a conic program.

The information M is affine in the powers, and variances are bounded from above by semidefinite
constraints (Boyd and Vandenberghe, Convex Optimization, 2004, sec. 7.5): t >= b'inv(M)b where
[[M, b], [b', t]] >= 0.  For the determinant, log det M is at least the sum of the logarithms of
the diagonal of a triangular Z with [[M, Z], [Z', diag Z]] >= 0.  Clarabel solves the program.
"""

from __future__ import annotations

import math

import numpy as np

from pilotid.support.types import FloatArray, InputError

TOLERANCE = 1e-10  # of the solver: lines of little power lie near their limits


def least(
    base: FloatArray,
    factors: FloatArray,
    weights: FloatArray | None,
    rows: FloatArray,
    room: FloatArray,
    equal: FloatArray,
) -> FloatArray:
    """The powers, not below zero, that minimise variances within limits, shape (lines,).

    Parameters
    ----------
    base, factors
        Information without lines, (parameters, parameters), and of each line with unit
        power, (lines, parameters, 2).
    weights
        Of the parameters' variances, shape (parameters,); None for the volume.
    rows, room
        Limits, rows @ powers <= room, shapes (limits, lines) and (limits,).
    equal
        Limits, equal @ powers = 0, shape (limits, lines).

    Raises
    ------
    InputError
        If no powers keep the limits.
    """
    import clarabel
    from scipy import sparse

    lines = len(factors)
    # In units in which the information is about one.
    forced = factors @ factors.transpose(0, 2, 1)
    root = np.linalg.inv(np.linalg.cholesky(base + forced.sum(axis=0)))
    base, forced = root @ base @ root.T, root @ forced @ root.T
    if weights is None:
        cost, semidefinite, logarithms = _volume(base, forced)
    else:
        cost, semidefinite, logarithms = _variances(base, forced, root, weights)
    more = np.zeros((1, cost.size - lines))

    def wide(matrix: FloatArray) -> FloatArray:
        return np.hstack([matrix, np.repeat(more, len(matrix), axis=0)])

    parts = [
        (clarabel.ZeroConeT(len(equal)), wide(equal), np.zeros(len(equal))),
        (clarabel.NonnegativeConeT(len(rows)), wide(rows), room),
        (clarabel.NonnegativeConeT(lines), wide(-np.eye(lines)), np.zeros(lines)),
    ]
    for constant, terms in semidefinite:
        row, column = np.tril_indices(len(constant))
        scale = np.where(row == column, 1.0, math.sqrt(2.0))
        cone = clarabel.PSDTriangleConeT(len(constant))
        parts.append((cone, -(terms[:, row, column] * scale).T, constant[row, column] * scale))
    for logarithm, entry in logarithms:
        matrix = np.zeros((3, cost.size))
        matrix[0, logarithm] = matrix[2, entry] = -1.0
        parts.append((clarabel.ExponentialConeT(), matrix, np.array([0.0, 1.0, 0.0])))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = TOLERANCE
    answer = clarabel.DefaultSolver(
        sparse.csc_matrix((cost.size, cost.size)),
        cost,
        sparse.csc_matrix(np.vstack([matrix for _, matrix, _ in parts])),
        np.concatenate([constant for *_, constant in parts]),
        [cone for cone, *_ in parts],
        settings,
    ).solve()
    if "Solved" not in str(answer.status):
        raise InputError(f"no powers of the lines keep these limits ({answer.status}); widen them")
    return np.asarray(np.maximum(answer.x, 0.0)[:lines])


Matrices = list[tuple[FloatArray, FloatArray]]
Pairs = list[tuple[int, int]]


def _variances(
    base: FloatArray, forced: FloatArray, root: FloatArray, weights: FloatArray
) -> tuple[FloatArray, Matrices, Pairs]:
    """A cost that is the sum of bounds on variances, and a matrix for each of them."""
    lines, size, asked = len(forced), len(base), np.flatnonzero(weights)
    cost = np.concatenate([np.zeros(lines), np.ones(asked.size)])
    found: Matrices = []
    for place, key in enumerate(asked):
        constant = np.zeros((size + 1, size + 1))
        constant[:size, :size] = base
        constant[:size, size] = constant[size, :size] = root[:, key] * math.sqrt(weights[key])
        terms = np.zeros((cost.size, size + 1, size + 1))
        terms[:lines, :size, :size] = forced
        terms[lines + place, size, size] = 1.0
        found.append((constant, terms))
    return cost, found, []


def _volume(base: FloatArray, forced: FloatArray) -> tuple[FloatArray, Matrices, Pairs]:
    """A cost that is minus the sum of logarithms of a triangle's diagonal."""
    lines, size = len(forced), len(base)
    row, column = np.tril_indices(size)
    own, logarithm = lines + np.arange(row.size), lines + row.size + np.arange(size)
    cost = np.zeros(lines + row.size + size)
    cost[logarithm] = -1.0 / size
    constant, terms = np.zeros((2 * size, 2 * size)), np.zeros((cost.size, 2 * size, 2 * size))
    constant[:size, :size], terms[:lines, :size, :size] = base, forced
    terms[own, row, size + column] = terms[own, size + column, row] = 1.0
    diagonal = own[row == column]
    terms[diagonal, size + np.arange(size), size + np.arange(size)] = 1.0
    return cost, [(constant, terms)], list(zip(logarithm.tolist(), diagonal.tolist(), strict=True))
