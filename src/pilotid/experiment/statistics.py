"""Paired tests, corrections for several tests, analysis of variance, power; plain arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from pilotid.support.types import FloatArray

#: Differences are equal if they scatter by no more than the rounding of what they are made of.
ROUNDING = 1e-12


def paired(a: FloatArray, b: FloatArray) -> dict[str, Any]:
    """The paired t-test of b - a, its robust counterpart and its effect size.

    Parameters
    ----------
    a, b
        Values by subject, shape (subjects,).

    Returns
    -------
    dict
        Columns of contrasts.csv; those that cannot be worked out are missing.
        ``robust_difference`` is the Hodges-Lehmann mean, ``effect_size`` Cohen's d_z with Hedges'
        (1981) correction.
    """
    from scipy.stats import ttest_rel, wilcoxon

    apart = b - a
    count = len(apart)
    found: dict[str, Any] = {"subjects": count}
    if not count:
        return found
    found |= {"mean_a": a.mean(), "mean_b": b.mean(), "difference": apart.mean()}
    if count < 2:
        return found
    deviation = float(np.std(apart, ddof=1))
    if deviation <= ROUNDING * float(np.abs([a, b]).max()):
        return found | {"std_error": 0.0}
    first, second = np.triu_indices(count)
    test = ttest_rel(b, a)
    lower, upper = test.confidence_interval()
    return found | {
        "std_error": deviation / math.sqrt(count),
        "t": test.statistic,
        "freedom": test.df,
        "p": test.pvalue,
        "lower_95": lower,
        "upper_95": upper,
        "effect_size": apart.mean() / deviation * _hedges(count - 1) if count > 2 else math.nan,
        "robust_difference": np.median(0.5 * (apart[first] + apart[second])),
        "wilcoxon_p": wilcoxon(apart).pvalue,
    }


def _hedges(freedom: int) -> float:
    half = 0.5 * freedom
    return math.exp(math.lgamma(half) - math.lgamma(half - 0.5) - 0.5 * math.log(half))


def holm(p: FloatArray) -> FloatArray:
    """Holm's (1979) correction of p-values for their number; NaN are no tests and do not count."""
    found = np.array(p, dtype=float)
    order = np.argsort(found)[: np.count_nonzero(np.isfinite(found))]  # NaN come last
    times = np.arange(len(order), 0, -1)
    found[order] = np.minimum(np.maximum.accumulate(times * found[order]), 1.0)
    return found


def anova(values: FloatArray, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Repeated-measures analysis of variance of a full crossing of factors within subjects.

    Parameters
    ----------
    values
        Shape (subjects, levels of the first factor, levels of the second, ...).
    names
        The factors.

    Returns
    -------
    dict
        By effect, such as ``motion:dynamics``: F, its degrees of freedom and p, epsilon and p
        after Greenhouse and Geisser (1959), partial eta squared.  Effects that do not scatter are
        missing.
    """
    from scipy.special import fdtrc

    count, *levels = values.shape
    table, found = values.reshape(count, -1), {}
    for size in range(1, len(names) + 1) if count > 1 else ():
        for some in combinations(range(len(names)), size):
            own: FloatArray = np.ones((1, 1))
            for place, level in enumerate(levels):
                mean = np.full((level, level), 1.0 / level)
                part = np.eye(level) - mean if place in some else mean
                own = np.asarray(np.kron(own, part), dtype=float)
            effect = table @ own
            spread = np.cov(effect, rowvar=False)
            if np.sqrt(np.trace(spread)) <= ROUNDING * np.abs(table).max():
                continue
            df1 = float(np.prod([levels[place] - 1 for place in some]))
            df2 = df1 * (count - 1)
            f = count * float(np.sum(effect.mean(axis=0) ** 2)) / float(np.trace(spread))
            epsilon = float(np.trace(spread) ** 2 / (df1 * np.sum(spread**2)))
            found[":".join(names[place] for place in some)] = {
                "F": f, "df1": df1, "df2": df2, "p": float(fdtrc(df1, df2, f)), "epsilon": epsilon,
                "p_corrected": float(fdtrc(epsilon * df1, epsilon * df2, f)),
                "eta_squared": f * df1 / (f * df1 + df2),
            }  # fmt: skip
    return found


def subjects_needed(effect: float, power: float, most: int = 1000) -> int | None:
    """The fewest subjects with whom a paired t-test finds a difference; None if not `most` do.

    Parameters
    ----------
    effect
        The difference over the standard deviation of the subjects' differences.
    power
        How often it is to be found at 5 %.
    most
        The most subjects that are tried.
    """
    from scipy.stats import nct, t

    counts = np.arange(2, most + 1)
    limit, shift = t.isf(0.025, counts - 1), effect * np.sqrt(counts)
    found = nct.sf(limit, counts - 1, shift) + nct.cdf(-limit, counts - 1, shift)
    enough = np.flatnonzero(found >= power)
    return int(counts[enough[0]]) if enough.size else None
