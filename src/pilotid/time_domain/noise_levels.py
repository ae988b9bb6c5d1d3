"""Noise levels of a pilot whose parameters walk at random, by likelihood.

The likelihood is that of the innovations of the filter.  A filter of many sets of levels takes
hardly longer than of one, so that the search goes by rounds of many: each draws its sets
around the best ones so far, and tries the top of the parabola through them as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.time_domain.unscented import Filtered, Levels, filtered
from pilotid.time_domain.walking import WalkingPilot
from pilotid.types import FloatArray

#: Standard deviations at the start: of logarithms, and of a delay in seconds.
APART, APART_DELAY = 0.5, 0.05
#: Noise of the neuromuscular system over a step, as share of the control: it keeps covariances
#: positive.
MOTOR = 1e-3
#: White part of a remnant with a lag, as share of its standard deviation.
WHITE = 0.03
#: Distance of the sigma points over the root of the number of parameters.
SPREAD = 1.05
#: Least and largest standard deviation of a walk after a second, of logarithms.
SLOWEST, FASTEST = 1e-3, 0.7
USUAL_WALK, USUAL_LAG = 0.06, 0.2
LAGS = (0.02, 2.0)  # s
REMNANTS = (0.003, 1.5)  # standard deviation over that of the control
ELITE = 8
LEAST = 0.01  # weight of a set that is kept
WIDER = 1.3  # by how much the next round is wider than the best of those before


@dataclass(frozen=True, eq=False)
class Walks:
    """A pilot, where its filter starts, and which of its parameters walk together.

    Attributes
    ----------
    pilot
        The system.
    start
        Parameters in model order, shape (parameters,).
    groups
        Per level of the walks how far each parameter goes with it, shape (walks, parameters).
    remnant
        Standard deviation of the remnant to begin with, over that of the control.
    order
        Of the remnant: 0 for a white one, else white noise through so many equal lags, 1 or 2.
    """

    pilot: WalkingPilot
    start: FloatArray
    groups: FloatArray
    remnant: float
    order: int

    @property
    def usual(self) -> FloatArray:
        """Where the search begins: logarithms of the levels, shape (levels,)."""
        first = [USUAL_WALK] * len(self.groups) + [np.clip(self.remnant, *REMNANTS)]
        return np.asarray(np.log([*first, USUAL_LAG] if self.order else first), dtype=float)

    @property
    def bounds(self) -> FloatArray:
        """Logarithms of the least and the largest levels, shape (2, levels)."""
        pairs = [(SLOWEST, FASTEST)] * len(self.groups) + [REMNANTS]
        return np.asarray(np.log([*pairs, LAGS] if self.order else pairs), dtype=float).T

    @property
    def spread(self) -> float:
        """Distance of the sigma points."""
        return float(SPREAD * np.sqrt(len(self.start)))

    def system(self, levels: FloatArray) -> tuple[WalkingPilot, Levels]:
        """The system and its noise, for sets of logarithms of levels, shape (sets, levels)."""
        pilot, sets, count = self.pilot, len(levels), len(self.start)
        walks = np.exp(2.0 * levels[:, : len(self.groups)]) @ self.groups**2 * pilot.dt
        variance = np.exp(2.0 * levels[:, len(self.groups)])
        size = 2 + self.order
        first, noise = np.zeros((sets, size, size)), np.zeros((sets, size, size))
        mean = pilot.to_walk(self.start)
        rate = np.exp(mean[0])  # of the control's rate over the control
        first[:, :2, :2] = np.diag([1.0, rate**2])
        noise[:, :2, :2] = MOTOR**2 * np.diag([1.0, rate**2])
        error, step = variance, np.zeros((sets, 0, 0))
        if self.order:
            step, still = _lags(pilot.dt / np.exp(levels[:, -1]), self.order)
            first[:, 2:, 2:] = variance[:, None, None] * still
            left = first[:, 2:, 2:]
            noise[:, 2:, 2:] = left - step @ left @ step.swapaxes(1, 2)
            error = WHITE**2 * variance
        means = np.zeros((sets, count + pilot.runs * size))
        means[:, :count] = mean
        covariance = np.zeros((*means.shape, means.shape[1]))
        apart = np.where(pilot.positive, APART, APART_DELAY)
        covariance[:, :count, :count] = np.diag(apart**2)
        for run in range(pilot.runs):
            own = slice(count + run * size, count + (run + 1) * size)
            covariance[:, own, own] = first
        return pilot.with_remnant(step), Levels(walks, noise, error, means, covariance)

    def filtered(self, levels: FloatArray, *, keep: bool = False) -> Filtered:
        """The filters of sets of logarithms of levels."""
        return filtered(*self.system(levels), self.spread, keep=keep)


def _lags(share: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Step of white noise behind one or two equal lags, and its covariance at rest.

    Parameters
    ----------
    share
        Length of a step over the lag, shape (sets,).
    order
        Number of lags; the last is the output, whose variance is 1.
    """
    still = np.array([[1.0]]) if order == 1 else np.array([[2.0, 1.0], [1.0, 1.0]])
    step = np.exp(-share)[:, None, None] * np.eye(order)
    if order == 2:
        step[:, 1, 0] = np.exp(-share) * share
    return step, still


@dataclass(frozen=True, eq=False)
class Found:
    """The end of a search.

    Attributes
    ----------
    walks
        What the levels are of.
    levels
        Logarithms of likely levels, the likeliest first, shape (sets, levels).
    weights
        How likely each set is, shape (sets,); their sum is 1.
    log_likelihood
        Of the likeliest; minus infinity if every filter broke down.
    """

    walks: Walks
    levels: FloatArray
    weights: FloatArray
    log_likelihood: float


def likeliest(
    choices: Sequence[Walks], rng: np.random.Generator, rounds: int, candidates: int, kept: int
) -> Found:
    """Search the levels, and of several remnants the likeliest by the first round.

    The likely sets are those of the last round, weighted for where it drew them: to take the
    best one alone would be to know the levels.

    Parameters
    ----------
    choices
        What is filtered, with other remnants.
    rng
        Draws the candidates.
    rounds, candidates
        Number of rounds, and of candidates in each.
    kept
        Most sets that are kept.
    """
    best, found = -np.inf, None
    for walks in choices:
        search = _Search(walks, rng)
        search.round(candidates)
        if found is None or search.worth.max() > best:
            best, found = float(search.worth.max()), search
    assert found is not None
    for _ in range(rounds - 1):
        found.round(candidates)
    return found.end(kept)


class _Search:
    """Sets of levels tried so far, and where the next are drawn."""

    def __init__(self, walks: Walks, rng: np.random.Generator) -> None:
        self.walks, self._rng = walks, rng
        self._low, self._high = walks.bounds
        self._middle = np.clip(walks.usual, self._low, self._high)
        wide = [1.0] * len(walks.groups) + [0.15] + [0.7] * (walks.order > 0)
        self._covariance = np.diag(np.square(wide))
        self.tried, self.worth = np.zeros((0, len(wide))), np.zeros(0)
        self._last, self._density = self.tried, self.worth

    def round(self, candidates: int) -> None:
        """Draw candidates, and move to where the best ones are."""
        root = np.linalg.cholesky(self._covariance)
        normal = self._rng.standard_normal((candidates, len(root)))
        normal[0] = 0.0
        top = _top(self.tried, self.worth)
        if top is not None:
            normal[1] = np.clip(np.linalg.solve(root, top - self._middle), -3.0, 3.0)
        drawn = np.clip(self._middle + normal @ root.T, self._low, self._high)
        self._density = -0.5 * np.sum(normal**2, axis=1)
        self._last = self.walks.filtered(drawn).log_likelihood
        self.tried = np.concatenate([self.tried, drawn])
        self.worth = np.concatenate([self.worth, self._last])
        best = np.argsort(-self.worth, kind="stable")[:ELITE]
        best = best[np.isfinite(self.worth[best])]
        if best.size < 2:
            return
        self._middle = self.tried[best].mean(axis=0)
        own = np.diag(np.var(self.tried[best], axis=0) + 1e-3)
        self._covariance = WIDER**2 * (0.5 * np.cov(self.tried[best].T) + 0.5 * own)

    def end(self, kept: int) -> Found:
        """The likely sets of the last round."""
        first = int(np.argmax(self.worth))
        best = float(self.worth[first])
        if not np.isfinite(best):
            return Found(self.walks, self.tried[:1], np.ones(1), best)
        levels, worth = self.tried[-len(self._last) :], self._last - self._density
        order = np.argsort(-worth, kind="stable")[:kept]
        weights = np.exp(worth[order] - worth[order[0]])
        order = order[weights > LEAST * weights.sum()]
        weights = weights[: len(order)] / weights[: len(order)].sum()
        return Found(self.walks, levels[order], weights, best)


def _top(tried: FloatArray, worth: FloatArray) -> FloatArray | None:
    """Top of the parabola through the better half of the sets; None if it has none."""
    size = tried.shape[1]
    terms = 1 + size + size * (size + 1) // 2
    order = np.argsort(-worth, kind="stable")
    order = order[np.isfinite(worth[order])][: max(len(worth) // 2, terms + 4)]
    if len(order) < terms + 4:
        return None
    centre, scale = tried[order].mean(axis=0), tried[order].std(axis=0) + 1e-9
    z = (tried[order] - centre) / scale
    rows, columns = np.triu_indices(size)
    design = np.column_stack([np.ones(len(z)), z, z[:, rows] * z[:, columns]])
    found = np.linalg.lstsq(design, worth[order], rcond=None)[0]
    curvature = np.zeros((size, size))
    curvature[rows, columns] = found[1 + size :]
    curvature = curvature + curvature.T
    if np.linalg.eigvalsh(curvature)[-1] >= 0.0:
        return None
    step = np.clip(np.linalg.solve(curvature, -found[1 : 1 + size]), -3.0, 3.0)
    return np.asarray(centre + scale * step)
