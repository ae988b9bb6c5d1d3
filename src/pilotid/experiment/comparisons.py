"""What follows from the frames of an experiment: contrasts, effects of factors, power, shifts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import combinations, product
from typing import Any

import numpy as np
from pandas import DataFrame, Series
from scipy.linalg import helmert
from scipy.special import fdtrc, poch
from scipy.stats import nct, t, ttest_rel, wilcoxon

from pilotid.experiment.files import in_order
from pilotid.experiment.results import Group, Results, conditions_of
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
#: Kinds of quantities: of signals, which need no model; of loops, which mean the same in every
#: model; and a model's parameters.
KINDS = ("measured", "loop", "parameter")
QUANTITY = ["method", "parameter", "unit"]


def compared(results: Results) -> Results:
    """The results with contrasts and effects of factors."""
    return replace(results, contrasts=contrasts(results), factors=effects(results))


#: A quantity of some conditions: where, in which models by condition, and its `cells_of`.
Quantity = tuple[dict[str, Any], Mapping[str, str], DataFrame]


def cells_of(
    results: Results, sets: Callable[[Sequence[str]], Sequence[Group]]
) -> Iterator[Quantity]:
    """Each quantity of sets of conditions that are compared, with the value of each subject.

    Parameters
    ----------
    results
        The results.
    sets
        Gives what is compared of the conditions of a stratum.

    Yields
    ------
    The stratum's fields, method, parameter, unit, and whether the models suit the conditions; the
    model by condition; and a row for each subject and condition with ``value``, the mean over
    recordings if there are more, NaN where none counts, and why it does not.
    """
    rows = results.quantities
    rows = rows[rows["run"].isna() & (rows["otherwise"] == "")]
    rows = rows[~rows["parameter"].str.startswith("rms_")]
    rows = rows.assign(value=rows["value"].where(rows["left_out"] == ""))
    place = [*results.strata, "kind", "condition", "model"]
    known = rows.groupby([*place, "subject", *QUANTITY], sort=False)
    means = known.agg(value=("value", "mean"), left_out=("left_out", "max")).reset_index()
    for stratum, there in conditions_of(results.parts).items():
        for kind, conditions in product(KINDS, sets(there)):
            for models, suits in _models(results, kind, stratum, conditions):
                asked = DataFrame([(*stratum, kind, *own) for own in models.items()], columns=place)
                for _, of in asked.merge(means).groupby(QUANTITY, sort=False):
                    # Not all models have all parameters.
                    if of["condition"].nunique() == len(conditions):
                        head = of.iloc[0][[*results.strata, *QUANTITY]].to_dict()
                        yield {**head, "model_suits": suits}, models, of


def _models(
    results: Results, kind: str, stratum: Group, some: Group
) -> list[tuple[Mapping[str, str], bool]]:
    """The models in which conditions are compared, by condition, and whether they suit these."""
    if kind == "measured":
        return [(dict.fromkeys(some, ""), True)]
    if not results.settings.auto:
        return [(dict.fromkeys(some, name), True) for name in results.settings.named]
    if kind == "loop":  # crossover and margin mean the same in any model
        return [({c: results.choices[(*stratum, c)].model for c in some}, True)]
    return [results.compared[stratum, some]]


def _subjects(of: DataFrame, conditions: Sequence[str]) -> tuple[DataFrame, str]:
    """Values of the subjects (rows) that count in all conditions (columns); who does not, why."""
    table = of.pivot(index="subject", columns="condition", values=["value", "left_out"])
    table, parameter = table.loc[in_order(table.index)], of["parameter"].iloc[0]
    whole = table["value"][[*conditions]].astype(float).dropna()
    if len(whole) == len(table):
        return whole, ""
    reasons = table["left_out"][[*conditions]].drop(index=whole.index).stack(future_stack=True)
    out = [
        f"subject {subject}, {f'{parameter} {why}' if isinstance(why, str) else 'no recording'}"
        f" in {condition}"
        for (subject, condition), why in reasons[reasons != ""].items()
    ]
    return whole, f"n = {len(whole)} of {len(table)}: {'; '.join(out)}"


# ------------------------------------------------------------------------------- contrasts


def contrasts(results: Results) -> DataFrame:
    """The differences by quantity, with Holm's p for the pairs.

    A disturbance loop that is the target loop, as without motion, is left out.
    """
    names, rows = results.strata, list[dict[str, Any]]()
    for head, models, of in cells_of(results, results.settings.condition_pairs):
        whole, notes = _subjects(of, [*models])
        a, b = models
        head |= {"condition_a": a, "condition_b": b, "model_a": models[a], "model_b": models[b]}
        numbers = paired(whole[a], whole[b])
        if "t" not in numbers:
            none = "no test: it takes two subjects, and differences that scatter"
            notes = " | ".join(filter(None, [notes, none]))
        rows.append(head | numbers | {"notes": notes})
    frame = DataFrame(rows, columns=[*names, *CONTRAST_COLUMNS])
    loops = frame["parameter"].str.replace("^(target|disturbance)_", "", regex=True)
    same = [*names, *CONTRAST_COLUMNS[:6], "mean_a", "mean_b"]
    frame = frame[~frame.assign(parameter=loops).round(9).duplicated(same)]
    quantity = [*names, *QUANTITY, *([] if results.settings.auto else ["model_a"])]
    order = frame.groupby(quantity, sort=False).ngroup()
    frame = frame.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)
    return frame.assign(p_holm=frame.groupby(quantity, sort=False)["p"].transform(holm))


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


def planned(results: Results) -> DataFrame:
    """How many subjects a difference of `SHARE` takes, by the spread of differences measured here.

    Columns: the stratum's fields, method, parameter, ``spread`` (standard deviation of the paired
    differences over the mean [%], root mean square over the pairs), ``subjects`` (NaN: over 1000).
    """
    known = results.contrasts[results.contrasts["t"].notna()]
    size = 0.5 * (known["mean_a"] + known["mean_b"])
    known = known.assign(spread=known["subjects"] * (100.0 * known["std_error"] / size) ** 2)
    keys = [*results.strata, *QUANTITY]
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


def effects(results: Results) -> DataFrame:
    """Effects of the factors on each quantity, of parameters in models that suit all conditions."""
    factors, rows = results.settings.factors, list[dict[str, Any]]()
    for head, models, of in cells_of(results, results.settings.crossed):
        whole, notes = _subjects(of, [*models])
        values = whole.to_numpy().reshape(-1, *factors.nunique())
        tests = anova(values, [*factors]) if 2 * len(whole) > of["subject"].nunique() else {}
        if not tests:
            tests, notes = {":".join(factors): {}}, f"not tested: {notes}"
        more = {"subjects": len(whole), "notes": notes}
        rows += [{**head, "effect": effect, **more, **test} for effect, test in tests.items()]
    return DataFrame(rows, columns=[*results.strata, *FACTOR_COLUMNS])


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


def not_compared(results: Results) -> Iterator[str]:
    """Which conditions have no model in which their parameters are compared, if there are any."""
    without = [
        " ".join((*stratum, ":".join(conditions)))
        for (stratum, conditions), (models, _) in results.compared.items()
        if not models
    ]
    if without:
        yield (
            f"{', '.join(without)}: no model is determined in all these conditions and suits them; "
            "what means the same in every model is compared, parameters are not."
        )


# ------------------------------------------------------------------------------ sensitivity


def sensitivity(results: Results) -> DataFrame:
    """Mean shifts of parameters that count, in claimed errors, by other ways to fit."""
    rows = results.quantities
    rows = rows[(rows["kind"] == "parameter") & (rows["left_out"] == "") & rows["run"].isna()]
    is_other = rows["otherwise"] != ""
    names = ["file", "model", *QUANTITY]
    both = rows[is_other].merge(rows.loc[~is_other, [*names, "value", "std_error"]], on=names)
    both["shift"] = (both["value_x"] - both["value_y"]) / both["std_error_y"]
    keys = [*results.strata, "condition", "otherwise", "method"]
    return both.pivot_table("shift", keys, "parameter", sort=False).reset_index()
