"""Powers of lines that minimise relative errors within linear limits: a conic program.

The information M is affine in the powers, and variances are bounded from above by semidefinite
constraints (Boyd and Vandenberghe, Convex Optimization, 2004, sec. 7.5): with M >= 0 for a
positive semidefinite matrix, T >= B'inv(M)B where [[M, B], [B', T]] >= 0, and the smallest
eigenvalue is at least l where M - l I >= 0.  For the determinant, log det M is at least the sum of
the logarithms of the diagonal of a triangular Z with [[M, Z], [Z', diag Z]] >= 0.  Clarabel solves
the program; its dual bounds what can be reached, and prices the limits.

Where the remnant's power is a share of the control's, M is affine in q = c p / (w'p) instead, with
w'p the control that the powers p force and c a constant: only ratios of powers count.  Every limit
a'p <= b is a'q <= b t with t = c / (w'p) for one more variable, so that the problem in q and t is
conic as well (Charnes and Cooper, Naval Research Logistics Quarterly 9, 1962, for fractions of
linear functions).  It holds for one pilot: each has a w of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from pilotid.designing.lines import Loop
from pilotid.types import FloatArray, InputError, IntArray

Kind = Literal["A", "D", "E"]
Over = Literal["mean", "worst"]
TOLERANCE = 1e-11  # of the solver: lines of little power lie near their limits


@dataclass(frozen=True, eq=False)
class Criterion:
    """One pilot's relative errors as one number, in units of a reference design's.

    Attributes
    ----------
    kind
        ``A``, the mean of the variances, of all parameters or of some; ``D``, the mean of the
        logarithms of the covariance's eigenvalues; ``E``, the largest of these.
    base, factors
        Information without lines, (parameters, parameters), and of each line with unit
        power, (lines, parameters, 2).
    weights
        Weights of the parameters' variances, for A, shape (parameters,).
    scale
        Value that counts as 1; for D what is taken off.
    """

    kind: Kind
    base: FloatArray
    factors: FloatArray
    weights: FloatArray
    scale: float = 1.0

    def information(self, powers: FloatArray) -> FloatArray:
        """Information at these powers, shape (parameters, parameters)."""
        return np.asarray(
            self.base + np.einsum("j,jpa,jqa->pq", powers, self.factors, self.factors)
        )

    def value(self, powers: FloatArray) -> float:
        """The criterion; inf where a parameter is not known at all."""
        information = self.information(powers)
        axes = np.linalg.eigvalsh(information)
        if not axes[0] > 0.0:
            return np.inf
        if self.kind == "D":
            return float(-np.mean(np.log(axes)) - self.scale)
        if self.kind == "E":
            return float(1.0 / axes[0] / self.scale)
        return float(self.weights @ np.diag(np.linalg.inv(information)) / self.scale)


class Aim(NamedTuple):
    """What is asked of a design, see `pilotid.designing.design.design`."""

    minimise: str
    wanted: Mapping[str, float]
    over: Over = "mean"


@dataclass(frozen=True, eq=False)
class Goal:
    """What is minimised: the mean of criteria, of pilots, or the worst of them."""

    criteria: Sequence[Criterion]
    over: Over = "mean"

    def value(self, powers: FloatArray) -> float:
        """The goal at these powers."""
        each = [criterion.value(powers) for criterion in self.criteria]
        return float(np.mean(each) if self.over == "mean" else np.max(each))


@dataclass(frozen=True, eq=False)
class Limit:
    """A linear limit, gradient'powers <= bound.

    Attributes
    ----------
    name
        For sentences: what binds.
    gradient
        Shape (lines,).
    bound
        What it must not exceed.
    equal
        Whether it must be equal to the bound.
    """

    name: str
    gradient: FloatArray
    bound: float
    equal: bool = False


@dataclass(frozen=True, eq=False)
class Optimum:
    """Powers, and how good they are.

    Attributes
    ----------
    powers
        Shape (lines,).
    value, lower
        The goal there, and what no powers within the limits can go below.
    prices
        Names of limits and by how much the goal falls where a limit is moved by the whole of
        its bound, largest first; those that do not bind are left out.
    """

    powers: FloatArray
    value: float
    lower: float
    prices: tuple[tuple[str, float], ...]


class InfeasibleError(InputError):
    """No powers keep the limits; the message names those that exclude one another."""


def minimise_within(
    goal: Goal, limits: Sequence[Limit], control: FloatArray | None = None, level: float = 1.0
) -> Optimum:
    """The powers that minimise a goal within limits; powers are never below zero.

    Parameters
    ----------
    goal
        Of powers, under which the remnant has the size that the goal's information holds for.
    limits
        On the powers.
    control
        Where the remnant's power is a share of the control's: the variance of the control for
        each unit of power, shape (lines,).
    level
        Variance of the control at which the remnant has that size.

    Raises
    ------
    InfeasibleError
        If there are no such powers.
    """
    # In units in which all limits are of one size, those to be equal last.
    limits = sorted(limits, key=lambda limit: limit.equal)
    bounding = [limit for limit in limits if not limit.equal]
    size = np.array([1.0 / max(np.abs(limit.gradient).max(), 1e-300) for limit in limits])
    rows = size[:, None] * np.array([limit.gradient for limit in limits])
    room = size * np.array([limit.bound for limit in limits])
    above, equal = slice(len(bounding)), slice(len(bounding), None)
    _require_room(bounding, rows[above], room[above], rows[equal], room[equal])

    program = _Program()
    powers, unit = program.variables(rows.shape[1]), program.variables(1)
    for cone, some in (("NonnegativeConeT", above), ("ZeroConeT", equal)):
        program.require(cone, 0.0, (powers, -rows[some]), (unit, room[some, None]))
    program.require("NonnegativeConeT", 0.0, (powers, np.eye(powers.size)))
    fixed = (unit, np.eye(1)) if control is None else (powers, control[None] / level)
    program.require("ZeroConeT", -1.0, fixed)
    _set_cost(program, goal, powers)
    answer = program.solve()
    if "Solved" not in str(answer.status):
        raise InputError(f"no optimum is found ({answer.status}); widen the limits")

    found = np.maximum(np.array(answer.x)[powers], 0.0) / answer.x[unit[0]]
    # Rounding may leave it just outside; where no level of power is asked for, less will do.
    is_level = room[above] > 0.01  # others are of small shares of the power
    if is_level.any() and not room[equal].any():
        found /= max(1.0, float(np.max((rows[above] @ found)[is_level] / room[above][is_level])))
    value = goal.value(found if control is None else found * level / float(control @ found))
    worth: dict[str, float] = {}
    saved = np.array(answer.z)[above] * room[above] * answer.x[unit[0]]
    for limit, price in zip(bounding, np.abs(saved).tolist(), strict=True):
        worth[limit.name] = worth.get(limit.name, 0.0) + price
    dear = [pair for pair in worth.items() if pair[1] > 1e-3 * abs(value)]
    return Optimum(
        found,
        value,
        min(value, program.offset + answer.obj_val_dual),
        tuple(sorted(dear, key=lambda pair: -pair[1])),
    )


def _require_room(
    limits: Sequence[Limit],
    rows: FloatArray,
    room: FloatArray,
    equal_rows: FloatArray,
    equal_room: FloatArray,
) -> None:
    """Refuse limits that leave no room, by the powers that are farthest inside."""
    from scipy.optimize import linprog

    lines = rows.shape[1]
    sides = np.concatenate([rows, -np.eye(lines)])
    answer = linprog(
        np.append(np.zeros(lines), -1.0),
        A_ub=np.column_stack([sides, np.abs(sides).sum(axis=1)]),
        b_ub=np.append(room, np.zeros(lines)),
        A_eq=np.pad(equal_rows, ((0, 0), (0, 1))),
        b_eq=equal_room,
        bounds=[(None, None)] * lines + [(None, 1.0)],
    )
    if answer.x is not None and (sides @ answer.x[:-1] < np.append(room, np.zeros(lines))).all():
        return
    duals = np.zeros(len(limits)) if answer.x is None else -answer.ineqlin.marginals[: len(limits)]
    against = dict.fromkeys(limits[i].name for i in np.argsort(-duals) if duals[i] > 1e-9)
    what = " and ".join(list(against)[:3]) or "the limits"
    raise InfeasibleError(f"no powers of the lines keep {what} at once; widen one of them")


def _set_cost(program: _Program, goal: Goal, powers: IntArray) -> None:
    """Make a goal the cost of a program."""
    worst = program.variables(1) if goal.over == "worst" else None
    for criterion in goal.criteria:
        constant, columns, row = _bound(program, criterion, powers)
        if worst is None:
            program.offset += constant / len(goal.criteria)
            program.cost[columns] += row / len(goal.criteria)
        else:
            program.require(
                "NonnegativeConeT", -constant, (worst, np.eye(1)), (columns, -row[None])
            )
    if worst is not None:
        program.cost[worst] = 1.0


def _bound(
    program: _Program, criterion: Criterion, powers: IntArray
) -> tuple[float, IntArray, FloatArray]:
    """What a criterion is not above: a constant, and a linear function of some variables."""
    # In units in which the information is about one.
    root = np.linalg.inv(np.linalg.cholesky(criterion.information(np.ones(powers.size))))
    base, factors = root @ criterion.base @ root.T, root @ criterion.factors
    size = len(base)
    lines = factors @ factors.transpose(0, 2, 1)
    if criterion.kind == "E":
        axis, above = program.variables(1), program.variables(1)
        unit = root @ root.T / criterion.scale
        program.require_positive(base, (powers, lines), (axis, -unit[None]))
        corners = np.array([[[1.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]]])
        product = np.array([[0.0, 1.0], [1.0, 0.0]])
        program.require_positive(product, (axis, corners[:1]), (above, corners[1:]))
        return 0.0, above, np.ones(1)
    is_asked = criterion.weights > 0.0
    count = size if criterion.kind == "D" else int(np.count_nonzero(is_asked))
    constant = np.zeros((size + count, size + count))
    constant[:size, :size] = base
    lines = np.pad(lines, ((0, 0), (0, count), (0, count)))
    # A triangle of variables, and where each of them stands in the matrix.
    rows, columns = np.tril_indices(count)
    own = program.variables(rows.size)
    on_diagonal = own[rows == columns]
    places = np.zeros((rows.size, size + count, size + count))
    number = np.arange(rows.size)
    if criterion.kind == "A":
        beside = root[:, is_asked] * np.sqrt(criterion.weights[is_asked] / criterion.scale)
        constant[:size, size:], constant[size:, :size] = beside, beside.T
        places[number, size + rows, size + columns] = 1.0
        places[number, size + columns, size + rows] = 1.0
        program.require_positive(constant, (powers, lines), (own, places))
        return 0.0, on_diagonal, np.ones(count)
    places[number, rows, size + columns] = places[number, size + columns, rows] = 1.0
    places[on_diagonal - own[0], size + np.arange(size), size + np.arange(size)] = 1.0
    program.require_positive(constant, (powers, lines), (own, places))
    logarithms = program.variables(size)
    for logarithm, entry in zip(logarithms, on_diagonal, strict=True):
        program.require(
            "ExponentialConeT",
            np.array([0.0, 1.0, 0.0]),
            (np.array([logarithm, entry]), np.eye(3)[:, [0, 2]]),
        )
    turned = 2.0 * np.linalg.slogdet(root)[1] / size
    return float(turned - criterion.scale), logarithms, np.full(size, -1.0 / size)


class _Program:
    """A linear cost of variables within cones."""

    def __init__(self) -> None:
        self.cost: FloatArray = np.zeros(0)
        self.offset = 0.0
        self._cones: list[tuple[str, int]] = []
        self._constants: list[FloatArray] = []
        self._terms: list[tuple[int, IntArray, FloatArray]] = []

    def variables(self, count: int) -> IntArray:
        """Places of new variables."""
        self.cost = np.append(self.cost, np.zeros(count))
        return np.arange(self.cost.size - count, self.cost.size)

    def require(
        self, cone: str, constant: FloatArray | float, *terms: tuple[IntArray, FloatArray]
    ) -> None:
        """Constant and terms, matrices of shape (rows, variables), add up to a point of a cone."""
        first, rows = sum(map(len, self._constants)), len(terms[0][1])
        if not rows:
            return
        self._cones.append((cone, rows))
        self._constants.append(np.broadcast_to(constant, rows))
        self._terms += [(first, columns, matrix) for columns, matrix in terms]

    def require_positive(self, constant: FloatArray, *terms: tuple[IntArray, FloatArray]) -> None:
        """A symmetric matrix, with terms of shape (variables, size, size), is semidefinite."""

        def triangle(matrix: FloatArray) -> FloatArray:
            rows, columns = np.tril_indices(len(constant))
            return np.asarray(matrix[..., rows, columns] * np.where(rows == columns, 1, 2**0.5))

        pairs = [(columns, triangle(matrices).T) for columns, matrices in terms]
        self.require("PSDTriangleConeT", triangle(constant), *pairs)

    def solve(self) -> Any:
        """Clarabel's answer."""
        import clarabel
        from scipy import sparse

        matrix = np.zeros((sum(map(len, self._constants)), self.cost.size))
        for first, columns, part in self._terms:
            matrix[first : first + len(part), columns] -= part
        cones = []
        for cone, rows in self._cones:
            sizes = {"PSDTriangleConeT": [math.isqrt(2 * rows)], "ExponentialConeT": []}
            cones.append(getattr(clarabel, cone)(*sizes.get(cone, [rows])))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = TOLERANCE
        nothing = sparse.csc_matrix((self.cost.size, self.cost.size))
        held, constants = sparse.csc_matrix(matrix), np.concatenate(self._constants)
        return clarabel.DefaultSolver(nothing, self.cost, held, constants, cones, settings).solve()


def _require_keys(named: Sequence[str], keys: Sequence[str]) -> None:
    unknown = [key for key in named if key not in keys]
    if unknown:
        raise InputError(
            f"there is no parameter '{unknown[0]}' to make small: choose from {', '.join(keys)}, "
            "or A, D or E"
        )


def _criteria(aim: Aim, loop: Loop, unit: FloatArray) -> list[Criterion]:
    """What counts of one pilot: one criterion, or variance over that wished for by parameter."""
    keys, minimise, wanted = loop.scenario.model.keys, aim.minimise, aim.wanted
    kind: Kind = "A"
    if wanted:
        _require_keys(list(wanted), keys)
        rows = np.eye(len(keys))
        asked = [(rows[keys.index(key)], share**2) for key, share in wanted.items()]
    elif minimise in ("A", "D", "E"):
        kind = "D" if minimise == "D" else "E" if minimise == "E" else "A"
        asked = [(np.full(len(keys), 1.0 / len(keys)), 0.0 if kind == "D" else 1.0)]
    else:
        named = [key.strip() for key in minimise.split(",")]
        _require_keys(named, keys)
        asked = [(np.array([named.count(key) / len(named) for key in keys]), 1.0)]
    information = loop.information
    factors = math.sqrt(information.runs) * information.factors * np.sqrt(unit)[:, None, None]
    base = information.runs * information.base
    return [Criterion(kind, base, factors, weights, scale) for weights, scale in asked]


def goal_of(
    aim: Aim, loops: Sequence[Loop], references: Sequence[Loop], usual: FloatArray, unit: FloatArray
) -> Goal:
    """The goal of a design: wishes, or each pilot's criterion in units of the reference's.

    Parameters
    ----------
    aim
        What is asked for.
    loops, references
        One for each pilot, with the lines of the design and those of the reference.
    usual
        Powers of the reference, shape (reference's lines,).
    unit
        Power of each line that counts as 1, shape (lines,).
    """
    found = []
    for loop, reference in zip(loops, references, strict=True):
        own = _criteria(aim, loop, unit)
        if not aim.wanted:
            (before,) = _criteria(aim, reference, np.ones(usual.size))
            own = [replace(own[0], scale=before.value(usual))]
        found += own
    return Goal(found, "worst" if aim.wanted else aim.over)


def gains_of(
    aim: Aim,
    loops: Sequence[Loop],
    references: Sequence[Loop],
    usual: FloatArray,
    powers: FloatArray,
) -> tuple[float, ...]:
    """Each pilot's objective over that with the reference, in terms of errors."""
    found = []
    for loop, reference in zip(loops, references, strict=True):
        after, before = (
            max(c.value(at) for c in _criteria(aim, own, np.ones(at.size)))
            for own, at in ((loop, loop.told(powers)), (reference, usual))
        )
        is_logarithm = aim.minimise == "D" and not aim.wanted
        ratio = math.exp(0.5 * (after - before)) if is_logarithm else math.sqrt(after / before)
        found.append(ratio)
    return tuple(found)
