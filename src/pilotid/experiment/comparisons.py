"""What follows from the frames of an experiment: contrasts, effects of factors, power, shifts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import reduce
from itertools import combinations
from typing import Any

import numpy as np
from pandas import DataFrame, Series
from scipy.linalg import helmert
from scipy.special import fdtrc, poch
from scipy.stats import nct, t, ttest_rel, wilcoxon

from pilotid.experiment.files import in_order
from pilotid.support.types import FloatArray

CONTRAST_COLUMNS = (
    *("condition_a", "condition_b", "model_a", "model_b", "method", "parameter", "unit"),
    *("subjects", "mean_a", "mean_b", "difference", "std_error", "t", "freedom", "p", "p_holm"),
    *("lower_95", "upper_95", "effect_size", "notes", "robust_difference", "wilcoxon_p"),
    "model_suits",
)
FACTOR_COLUMNS = (
    *("method", "parameter", "unit", "effect", "subjects", "F", "df1", "df2", "p", "epsilon"),
    *("p_corrected", "eta_squared", "notes"),
)
#: A difference of this share [%] is to be found this often by as many subjects as are needed.
SHARE, POWER = 15.0, 0.8
#: Differences are equal if they scatter by no more than the rounding of what they are made of.
ROUNDING = 1e-12
#: Tests: of differences between two conditions, and of effects of the factors.
CONTRAST, EFFECT = "contrast", "effect"
QUANTITY = ["method", "parameter", "unit"]


def quantities_of(
    cells: DataFrame, test: str, strata: Sequence[str]
) -> Iterator[tuple[dict[str, Any], DataFrame]]:
    """Each quantity of each comparison: what it is, and its cells in the conditions' order."""
    of_test = cells[cells["test"] == test]
    size = of_test.groupby("comparison")["condition"].transform("nunique")
    for _, of in of_test.groupby(["comparison", *QUANTITY], sort=False):
        if of["condition"].nunique() == size[of.index[0]]:  # not all models have all parameters
            yield of.iloc[0][[*strata, *QUANTITY, "family", "model_suits"]].to_dict(), of


def _subjects(of: DataFrame) -> tuple[DataFrame, str]:
    """Values of the subjects (rows) that count in all conditions (columns); who does not, why."""
    table = of.pivot(index="subject", columns="condition", values=["value", "left_out"])
    table, parameter = table.loc[in_order(table.index)], of["parameter"].iloc[0]
    conditions = of["condition"].unique()
    whole = table["value"][conditions].astype(float).dropna()
    reasons = table["left_out"][conditions].drop(index=whole.index).stack(future_stack=True)
    out = [
        f"subject {subject}, {f'{parameter} {why}' if isinstance(why, str) else 'no recording'}"
        f" in {condition}"
        for (subject, condition), why in reasons[reasons != ""].items()
    ]
    return whole, f"n = {len(whole)} of {len(table)}: {'; '.join(out)}" if out else ""


# ------------------------------------------------------------------------------- contrasts


def contrasts(cells: DataFrame, strata: Sequence[str]) -> DataFrame:
    """The differences by quantity, with Holm's p for the pairs.

    A disturbance loop that is the target loop, as without motion, is left out.

    Parameters
    ----------
    cells
        What is compared, with ``value`` by subject and condition, see `results.Results.cells`.
    strata
        Columns within whose values conditions are compared.
    """
    rows = list[dict[str, Any]]()
    for head, of in quantities_of(cells, CONTRAST, strata):
        whole, notes = _subjects(of)
        (a, first), (b, second) = of.groupby("condition", sort=False)["model"].first().items()
        head |= {"condition_a": a, "condition_b": b, "model_a": first, "model_b": second}
        rows.append(head | paired(whole[a], whole[b]) | {"notes": notes})
    frame = DataFrame(rows, columns=[*strata, "family", *CONTRAST_COLUMNS])
    loops = frame["parameter"].str.replace("^(target|disturbance)_", "", regex=True)
    same = [*strata, *CONTRAST_COLUMNS[:6], "mean_a", "mean_b"]
    frame = frame[~frame.assign(parameter=loops).round(9).duplicated(same)]
    quantity = [*strata, *QUANTITY, "family"]
    order = frame.groupby(quantity, sort=False).ngroup()
    frame = frame.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)
    frame["p_holm"] = frame.groupby(quantity, sort=False)["p"].transform(holm)
    return frame.drop(columns="family")


def paired(a: Series, b: Series) -> dict[str, Any]:
    """The paired t-test of b - a, its robust counterpart and its effect size.

    Parameters
    ----------
    a, b
        Values by subject.

    Returns
    -------
    dict
        Columns of contrasts.csv; those of tests are missing where there is none.
        ``robust_difference`` is the Hodges-Lehmann mean, ``effect_size`` Cohen's d_z with Hedges'
        (1981) correction.
    """
    apart, count = b - a, len(a)
    numbers = {"subjects": count, "mean_a": a.mean(), "mean_b": b.mean()}
    numbers |= {"difference": apart.mean(), "std_error": apart.sem()}
    if count < 2 or apart.std() <= ROUNDING * max(a.abs().max(), b.abs().max()):
        return numbers
    first, second = np.triu_indices(count)
    test, half = ttest_rel(b, a), 0.5 * (count - 1)
    hedges = poch(half - 0.5, 0.5) / math.sqrt(half) if count > 2 else math.nan
    lower, upper = test.confidence_interval()
    return numbers | {
        "t": test.statistic,
        "freedom": test.df,
        "p": test.pvalue,
        "lower_95": lower,
        "upper_95": upper,
        "effect_size": apart.mean() / apart.std() * hedges,
        "robust_difference": np.median(0.5 * (apart.to_numpy()[first] + apart.to_numpy()[second])),
        "wilcoxon_p": wilcoxon(apart).pvalue,
    }


def holm(p: Series) -> Series:
    """Holm's (1979) correction of p-values for their number; NaN are no tests and do not count."""
    known = p.dropna().sort_values()
    return (known * np.arange(len(known), 0, -1)).cummax().clip(upper=1.0).reindex(p.index)


def planned(contrasts: DataFrame, strata: Sequence[str]) -> DataFrame:
    """How many subjects a difference of `SHARE` takes, by the spread of these contrasts.

    Columns: the stratum's fields, method, parameter, ``spread`` (standard deviation of the paired
    differences over the mean [%], root mean square over the pairs), ``subjects`` (NaN: over 1000).
    """
    known = contrasts[contrasts["t"].notna()]
    size = 0.5 * (known["mean_a"] + known["mean_b"])
    known = known.assign(spread=known["subjects"] * (100.0 * known["std_error"] / size) ** 2)
    keys = [*strata, *QUANTITY]
    spread = known.groupby(keys, sort=False)["spread"].mean().pow(0.5).reset_index()
    return spread.assign(subjects=[subjects_needed(SHARE / s) for s in spread["spread"]])


def subjects_needed(effect: float) -> int | None:
    """The fewest subjects with whom a paired t-test at 5 % finds a difference as often as `POWER`.

    None for over 1000.

    Parameters
    ----------
    effect
        The difference over the standard deviation of the subjects' differences.
    """
    counts = np.arange(2, 1001)
    limit, shift = t.isf(0.025, counts - 1), effect * np.sqrt(counts)
    often = nct.sf(limit, counts - 1, shift) + nct.cdf(-limit, counts - 1, shift)
    enough = np.flatnonzero(often >= POWER)
    return int(counts[enough[0]]) if enough.size else None


# --------------------------------------------------------------------------------- factors


def effects(cells: DataFrame, strata: Sequence[str], factors: DataFrame) -> DataFrame:
    """Effects of the factors on each quantity, of parameters in models that suit all conditions.

    Parameters
    ----------
    cells, strata
        See `contrasts`.
    factors
        Level of each factor (columns) by condition.
    """
    rows = list[dict[str, Any]]()
    for head, of in quantities_of(cells, EFFECT, strata):
        whole, notes = _subjects(of)
        values = whole.to_numpy().reshape(-1, *factors.nunique())
        tests = anova(values, [*factors]) if 2 * len(whole) > of["subject"].nunique() else {}
        if not tests:
            tests, notes = {":".join(factors): {}}, f"not tested: {notes}"
        more = {"subjects": len(whole), "notes": notes}
        rows += [{**head, "effect": effect, **more, **test} for effect, test in tests.items()]
    return DataFrame(rows, columns=[*strata, *FACTOR_COLUMNS])


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
    count, *levels = values.shape
    table, tests = values.reshape(count, -1), {}
    for size in range(1, len(names) + 1) if count > 1 else ():
        for some in combinations(names, size):
            # Orthonormal contrasts of the effect's levels, means over those of other factors.
            parts = [
                helmert(level) if name in some else np.full((1, level), level**-0.5)
                for name, level in zip(names, levels, strict=True)
            ]
            effect = table @ reduce(np.kron, parts).T
            spread = np.atleast_2d(np.cov(effect, rowvar=False))
            if np.sqrt(np.trace(spread)) <= ROUNDING * np.abs(table).max():
                continue
            df1 = float(len(spread))
            df2 = df1 * (count - 1)
            f = count * float(np.sum(effect.mean(axis=0) ** 2)) / float(np.trace(spread))
            epsilon = float(np.trace(spread) ** 2 / (df1 * np.sum(spread**2)))
            tests[":".join(some)] = {
                "F": f, "df1": df1, "df2": df2, "p": float(fdtrc(df1, df2, f)), "epsilon": epsilon,
                "p_corrected": float(fdtrc(epsilon * df1, epsilon * df2, f)),
                "eta_squared": f * df1 / (f * df1 + df2),
            }  # fmt: skip
    return tests


# ------------------------------------------------------------------------------ sensitivity


def sensitivity(rows: DataFrame, strata: Sequence[str]) -> DataFrame:
    """Mean shifts of parameters that count, in claimed errors, by other ways to fit."""
    rows = rows[(rows["kind"] == "parameter") & (rows["left_out"] == "") & rows["run"].isna()]
    is_other = rows["otherwise"] != ""
    names = ["file", "model", *QUANTITY]
    both = rows[is_other].merge(rows.loc[~is_other, [*names, "value", "std_error"]], on=names)
    both["shift"] = (both["value_x"] - both["value_y"]) / both["std_error_y"]
    keys = [*strata, "condition", "otherwise", "method"]
    return both.pivot_table("shift", keys, "parameter", sort=False).reset_index()
