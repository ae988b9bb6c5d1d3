"""Learning curves: how estimates and performance go over runs and sessions.

For each subject an exponential approach is fitted by least squares,

    y(k) = end + (start - end) exp(-(k - 1)/constant),  k = 1, 2, ... the order of the runs,

and for all subjects together the same with an end of each subject's own, which where nothing is
missing is the curve of the means.  Errors of a subject's curve follow from the scatter about it
(first order); those of the common curve from leaving subjects out one by one (the jackknife, which
holds how subjects differ).  Whether anything changes at all is told by a straight line, whose test
is exact: an exponential's constant means nothing without a change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.analysis.combine import NAN, mean_of, plain_mean
from pilotid.analysis.rows import Row, Stratum, grouped, in_order
from pilotid.types import FloatArray

#: The field of a pattern that numbers sessions.
SESSION = "session"
#: Runs in which a curve of three parameters is told, and subjects who tell its error.
FEWEST, SUBJECTS = 5, 3
#: Constants that are tried, from a fifth of a run to so many times the runs there are.
SHORTEST, LONGEST, TRIED = 0.2, 3.0, 60


@dataclass(frozen=True)
class Curve:
    """An exponential approach, and a straight line, through numbers in order.

    Attributes
    ----------
    start, end
        What it is at order 1, and where it goes.
    constant
        Runs in which the distance to the end falls to 37 %.
    slope
        Mean change from one run to the next, by a straight line.
    """

    start: float
    end: float
    constant: float
    slope: float


@dataclass(frozen=True)
class Learning:
    """A quantity over runs: a line of learning.csv.

    What cannot be worked out is NaN, and `notes` say why.

    Attributes
    ----------
    stratum, condition, model, method, parameter, unit
        What was estimated, and how.
    subject
        Whose curve it is; empty for that of all subjects.
    points, subjects
        Runs with a usable estimate, and subjects.
    curve, errors
        The curve, and the standard errors of its numbers.
    p
        Of no change over the runs, by the straight line.
    notes
        What could not be worked out.
    values
        Order and value of each run, shape (points, 2); means over subjects for all of them.
    """

    stratum: Stratum
    condition: str
    model: str
    method: str
    parameter: str
    unit: str
    subject: str
    points: int
    subjects: int
    curve: Curve
    errors: Curve
    p: float
    notes: tuple[str, ...]
    values: FloatArray


def learning(rows: Sequence[Row]) -> list[Learning]:
    """Learning curves of each subject and of all, for each condition, model, method and quantity.

    Parameters
    ----------
    rows
        Rows of any fits.  The order is that of the field ``session``, and within it that of runs
        fitted one by one, if there are any.

    Returns
    -------
    Those of quantities with `FEWEST` runs of a subject or more.
    """
    single = {(row.file, row.method) for row in rows if row.run is not None}
    used = [row for row in rows if (row.run is None) != ((row.file, row.method) in single)]
    used = [row for row in used if row.run is not None or row.field(SESSION)]
    series = grouped(
        used, lambda row: (_stratum(row), row.condition, row.model, row.method, row.parameter)
    )
    return [line for own in series.values() for line in _curves(own)]


def _stratum(row: Row) -> Stratum:
    """The stratum without the session, over which curves go."""
    return tuple(pair for pair in row.stratum if pair[0] != SESSION)


def _curves(rows: Sequence[Row]) -> list[Learning]:
    sessions = in_order([row.field(SESSION) for row in rows])
    places = {(sessions.index(row.field(SESSION)), row.run or 0) for row in rows}
    order = {place: number for number, place in enumerate(sorted(places), start=1)}
    found: dict[str, dict[int, float]] = {}
    for row in rows:
        if row.usable and math.isfinite(row.value):
            place = order[sessions.index(row.field(SESSION)), row.run or 0]
            found.setdefault(row.person, {})[place] = row.value
    whole = {
        subject: np.array(sorted(found[subject].items()), dtype=float)
        for subject in in_order(list(found))
        if len(found[subject]) >= FEWEST
    }
    if not whole:
        return []
    about = (
        _stratum(rows[0]),
        rows[0].condition,
        rows[0].model,
        rows[0].method,
        rows[0].parameter,
        ", ".join(dict.fromkeys(row.unit for row in rows)),
    )
    lines = [
        Learning(*about, subject, len(own), 1, *_of_one(own), own) for subject, own in whole.items()
    ]
    if len(whole) > 1:
        mean = _mean(list(whole.values()))
        points = sum(map(len, whole.values()))
        lines.append(Learning(*about, "", points, len(whole), *_of_all(whole), mean))
    return lines


def _of_one(values: FloatArray) -> tuple[Curve, Curve, float, tuple[str, ...]]:
    """A subject's curve, its errors, the p of no change, and notes."""
    order, y = values.T
    curve = fitted([values])
    freedom = len(y) - 2
    centred = order - order.mean()
    line = y - y.mean() - curve.slope * centred
    slope = mean_of(
        curve.slope, math.sqrt(float(line @ line) / freedom / float(centred @ centred)), freedom
    )
    fall = np.exp(-(order - 1.0) / curve.constant)
    height = curve.start - curve.end
    jacobian = np.stack(
        [fall, 1.0 - fall, height * fall * (order - 1.0) / curve.constant**2], axis=1
    )
    rest = y - curve.end - height * fall
    errors = np.full(3, NAN)
    notes = _bounds(curve, len(y))
    if not notes and len(y) > 3:
        variance = float(rest @ rest) / (len(y) - 3)
        errors = np.sqrt(variance * np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    start, end, constant = map(float, errors)
    return curve, Curve(start, end, constant, slope.std_error), slope.p, notes


def _of_all(whole: Mapping[str, FloatArray]) -> tuple[Curve, Curve, float, tuple[str, ...]]:
    """The same of all subjects."""
    every = list(whole.values())
    curve = fitted(every)
    slope = plain_mean(np.array([fitted([own]).slope for own in every]))
    notes = list(_bounds(curve, max(map(len, every))))
    errors = np.full(3, NAN)
    if len(every) < SUBJECTS:
        notes.append(f"no errors of the curve: fewer than {SUBJECTS} subjects")
    elif not notes:
        left = [fitted([*every[:i], *every[i + 1 :]]) for i in range(len(every))]
        table = np.array([[own.start, own.end, own.constant] for own in left])
        errors = np.std(table, axis=0) * math.sqrt(len(every) - 1)
    start, end, constant = map(float, errors)
    return curve, Curve(start, end, constant, slope.std_error), slope.p, tuple(notes)


def _bounds(curve: Curve, count: int) -> tuple[str, ...]:
    if curve.constant >= 0.99 * LONGEST * count:
        return ("nearly a straight line: where it ends is not told",)
    if curve.constant <= 1.01 * SHORTEST:
        return ("the first run differs from all others: how fast it falls is not told",)
    return ()


def fitted(subjects: Sequence[FloatArray]) -> Curve:
    """The curve that fits best, with an end of its own for each subject.

    Parameters
    ----------
    subjects
        Order and value of each run, a table of shape (points, 2) for each subject.
    """
    from scipy.optimize import minimize_scalar

    count = max(len(own) for own in subjects)
    levels = [float(own[:, 1].mean()) for own in subjects]
    y = np.concatenate([own[:, 1] - m for own, m in zip(subjects, levels, strict=True)])

    def regressor(shape: str, constant: float = 1.0) -> tuple[FloatArray, float]:
        """What is left of a curve from 1 to 0, or of a line, without each subject's mean."""
        parts, means = [], []
        for own in subjects:
            steps = own[:, 0] - 1.0
            part = np.exp(-steps / constant) if shape == "fall" else steps
            parts.append(part - part.mean())
            means.append(float(part.mean()))
        return np.concatenate(parts), float(np.mean(means))

    def left(log_constant: float) -> float:
        column, _ = regressor("fall", math.exp(log_constant))
        return float(y @ y - (column @ y) ** 2 / (column @ column))

    grid = np.linspace(math.log(SHORTEST), math.log(LONGEST * count), TRIED)
    best = int(np.argmin([left(value) for value in grid]))
    ends = (grid[max(best - 1, 0)], grid[min(best + 1, TRIED - 1)])
    end = minimize_scalar(left, bounds=ends, method="bounded", options={"xatol": 1e-6})
    log_constant = float(end.x if end.fun < left(grid[best]) else grid[best])
    column, mean = regressor("fall", math.exp(log_constant))
    height = float(column @ y / (column @ column))
    line, _ = regressor("line")
    asymptote = float(np.mean(levels)) - height * mean
    slope = float(line @ y / (line @ line))
    return Curve(asymptote + height, asymptote, math.exp(log_constant), slope)


def _mean(every: Sequence[FloatArray]) -> FloatArray:
    """Means over subjects at each order that all of them have."""
    shared = sorted(set.intersection(*(set(own[:, 0]) for own in every)))
    values = [dict(zip(own[:, 0], own[:, 1], strict=True)) for own in every]
    return np.array([[k, np.mean([own[k] for own in values])] for k in shared]).reshape(-1, 2)
