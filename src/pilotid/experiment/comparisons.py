"""What follows from the frames of an experiment: contrasts, effects of factors, power, shifts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.experiment.files import CONDITION, SUBJECT, in_order
from pilotid.experiment.results import KINDS, LEFT_OUT, LOOP, MEASURED, PARAMETER, Group, Results
from pilotid.experiment.statistics import anova, holm, paired, subjects_needed
from pilotid.support.numbers import LEVEL
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

CONTRAST_COLUMNS = (
    *("condition_a", "condition_b", "model_a", "model_b", "method", "parameter", "unit"),
    *("subjects", "mean_a", "mean_b", "difference", "std_error", "t", "freedom", "p", "p_holm"),
    *("lower_95", "upper_95", "effect_size", "notes", "robust_difference", "wilcoxon_p"),
    *("lower_holm_95", "upper_holm_95"),
)
FACTOR_COLUMNS = (
    *("method", "parameter", "unit", "effect", "subjects", "F", "df1", "df2", "p", "epsilon"),
    *("p_corrected", "eta_squared", "notes"),
)
#: A difference of this share is to be found this often by as many subjects as are needed.
SHARE, POWER = 0.15, 0.8
#: Cells by stratum, kind, condition and model.
Cells = Mapping[tuple[str, ...], "DataFrame"]


def compared(results: Results) -> Results:
    """The results with contrasts and effects of factors.

    Raises
    ------
    InputError
        If a pair is not of two conditions that there are.
    """
    conditions = {part.field(CONDITION) for part in results.parts}
    for a, b in results.settings.pairs:
        if a == b or not {a, b} <= conditions:
            raise InputError(
                f"--contrast {a}:{b}: must be two conditions of {{condition}} in the pattern, of "
                f"which there are {', '.join(in_order([*conditions])) or 'none'}"
            )
    if not {SUBJECT, CONDITION} <= {*results.fields}:
        return results
    cells = cells_of(results)
    return replace(results, contrasts=contrasts(results, cells), factors=effects(results, cells))


def cells_of(results: Results) -> Cells:
    """The value of each subject in each condition: the mean over recordings if there are more."""
    found = results.quantities
    found = found[found["run"].isna() & (found["otherwise"] == "")]
    found = found[~found["parameter"].str.startswith("rms_")]
    found = found.assign(value=found["value"].where(found[LEFT_OUT] == ""))
    place = [*results.strata, "kind", CONDITION, "model"]
    means = (
        found.groupby([*place, SUBJECT, "method", "parameter"], sort=False)
        .agg(unit=("unit", "first"), value=("value", "mean"), left_out=(LEFT_OUT, "max"))
        .reset_index()
    )
    return dict(iter(means.groupby(place, sort=False)))


def _models(results: Results, kind: str, stratum: Group, own: Group) -> list[Mapping[str, str]]:
    """The models in which conditions are compared, by condition."""
    if kind == MEASURED:
        return [dict.fromkeys(own, "")]
    if not results.settings.auto:
        return [dict.fromkeys(own, name) for name in results.settings.models]
    if kind == LOOP:  # crossover and margin mean the same in any model
        return [{c: results.choices[(*stratum, c)].model for c in own}]
    models, _ = results.compared[stratum, own]
    return [models] if models else []


def _strata(results: Results) -> dict[Group, list[str]]:
    """The conditions of each stratum."""
    found: dict[Group, list[str]] = {}
    for part in results.parts:
        found.setdefault(part.stratum, []).append(part.field(CONDITION))
    return {stratum: in_order(own) for stratum, own in found.items()}


# ------------------------------------------------------------------------------- contrasts


def contrasts(results: Results, cells: Cells) -> DataFrame:
    """The differences by quantity, with Holm's p for the pairs, and the interval of the same level.

    A disturbance loop that is the target loop, as without motion, is left out.
    """
    from pandas import DataFrame
    from scipy.special import stdtrit

    strata, auto = results.strata, results.settings.auto
    columns = [*strata, *CONTRAST_COLUMNS]
    frame = DataFrame([*_differences(results, cells)], columns=columns)
    ends = frame[[*strata, *CONTRAST_COLUMNS[:6], "mean_a", "mean_b"]].round(9)
    loops = ends["parameter"].str.replace("^(target|disturbance)_", "", regex=True)
    frame = frame[~ends.assign(parameter=loops).duplicated()]
    quantity = [*strata, "method", "parameter", *([] if auto else ["model_a"])]
    order = frame.groupby(quantity, sort=False).ngroup()
    frame = frame.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)
    p_holm = frame.groupby(quantity, sort=False)["p"].transform(holm)
    level = 1.0 - 0.5 * LEVEL * (frame["p"] / p_holm).astype(float)
    reach = stdtrit(frame["freedom"].astype(float), level) * frame["std_error"]
    low, high = frame["difference"] - reach, frame["difference"] + reach
    return frame.assign(p_holm=p_holm, lower_holm_95=low, upper_holm_95=high)


def _differences(results: Results, cells: Cells) -> Iterator[dict[str, Any]]:
    """A row for each quantity that both conditions of a pair have."""
    for stratum, conditions in _strata(results).items():
        for kind, pair in product(KINDS, results.settings.condition_pairs(conditions)):
            for models in _models(results, kind, stratum, pair):
                places = [(*stratum, kind, c, models[c]) for c in pair]
                if not {*places} <= {*cells}:
                    continue
                a, b = (cells[place].set_index(["method", "parameter"]) for place in places)
                for key in a.index.drop_duplicates():
                    if key in b.index:
                        own = (*stratum, *pair, *(models[c] for c in pair), *key)
                        named = dict(zip((*results.strata, *CONTRAST_COLUMNS), own, strict=False))
                        yield named | _contrast(named, a.loc[[key]], b.loc[[key]])


def _contrast(named: Mapping[str, str], one: DataFrame, two: DataFrame) -> dict[str, Any]:
    """One difference, with the subjects that count and why others do not."""
    both = one.merge(two, "outer", SUBJECT, suffixes=("_a", "_b")).set_index(SUBJECT)
    both = both.loc[in_order([*both.index])]
    whole = both[["value_a", "value_b"]].dropna()
    units = dict.fromkeys([*one["unit"], *two["unit"]])
    notes, out = [], []
    for subject, row in both.drop(index=whole.index).iterrows():
        for side in "ab":
            condition, why = named[f"condition_{side}"], row[f"{LEFT_OUT}_{side}"]
            if isinstance(why, float):  # the subject has no such cell
                out.append(f"subject {subject}, no recording in {condition}")
            elif why:
                out.append(f"subject {subject}, {named['parameter']} {why} in {condition}")
    if out:
        notes.append(f"n = {len(whole)} of {len(both)}: {'; '.join(dict.fromkeys(out))}")
    numbers = paired(whole["value_a"].to_numpy(), whole["value_b"].to_numpy())
    if len(units) > 1:
        numbers = {"subjects": len(whole)}
        notes.append(f"the units differ ({', '.join(units)}): no test")
    elif len(whole) < 2:
        notes.append("a test takes two subjects")
    elif "t" not in numbers:
        notes.append("all subjects have the same difference: no test")
    return {**numbers, "unit": ", ".join(units), "notes": " | ".join(notes)}


def planned(results: Results) -> DataFrame:
    """How many subjects a difference of `SHARE` takes, by the spread of differences measured here.

    Columns: the stratum's fields, method, parameter, ``spread`` (standard deviation of the paired
    differences over the mean, root mean square over the pairs), ``subjects`` (NaN: over 1000).
    """
    found = results.contrasts
    known = found[found["t"].notna()]
    size = 0.5 * (known["mean_a"] + known["mean_b"])
    known = known.assign(spread=known["subjects"] * (known["std_error"] / size) ** 2)
    keys = [*results.strata, "method", "parameter"]
    spread = known.groupby(keys, sort=False)["spread"].mean().pow(0.5).reset_index()
    return spread.assign(subjects=[subjects_needed(SHARE / s, POWER) for s in spread["spread"]])


# --------------------------------------------------------------------------------- factors


def effects(results: Results, cells: Cells) -> DataFrame:
    """Effects of the factors on each quantity, of parameters in models that suit all conditions."""
    from pandas import DataFrame

    columns = [*results.strata, *FACTOR_COLUMNS]
    return DataFrame([*_effects(results, cells, columns)], columns=columns)


def _effects(results: Results, cells: Cells, columns: Sequence[str]) -> Iterator[dict[str, Any]]:
    from pandas import concat

    factors = results.settings.factors
    if factors is None:
        return
    levels = [[*dict.fromkeys(factors[name])] for name in factors]
    by_cell = dict(zip(factors.itertuples(index=False, name=None), factors.index, strict=True))
    conditions = [by_cell[cell] for cell in product(*levels)]
    shape = [len(own) for own in levels]
    for stratum, there in _strata(results).items():
        for kind in KINDS if {*conditions} <= {*there} else ():
            for models in _models(results, kind, stratum, tuple(factors.index)):
                places = [(*stratum, kind, c, models[c]) for c in conditions]
                if not {*places} <= {*cells}:
                    continue
                whole = concat([cells[place] for place in places])
                for key, own in whole.groupby(["method", "parameter"], sort=False):
                    head = dict(
                        zip((*results.strata, *FACTOR_COLUMNS), (*stratum, *key), strict=False)
                    )
                    for tested in _tested(own, conditions, shape, [*factors]):
                        yield head | {"unit": own["unit"].iloc[0], **tested}


def _tested(
    cells: DataFrame, conditions: Sequence[str], shape: Sequence[int], names: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """A row for each effect on one quantity, or one that says why there is no test."""
    if {*cells[CONDITION]} < {*conditions}:
        return  # a parameter that some models do not have
    table = cells.pivot(index=SUBJECT, columns=CONDITION, values="value")[[*conditions]]
    whole = table.dropna()
    missing = table.isna()
    out = [f"subject {s}, {missing.columns[row][0]}" for s, row in missing.iterrows() if row.any()]
    notes = f"n = {len(whole)} of {len(table)}: not determined in {'; '.join(out)}" if out else ""
    found = anova(whole.to_numpy().reshape(-1, *shape), names) if 2 * len(out) < len(table) else {}
    if not found:
        yield {"effect": ":".join(names), "subjects": len(whole), "notes": f"not tested: {notes}"}
    for effect, numbers in found.items():
        yield {"effect": effect, "subjects": len(whole), **numbers, "notes": notes}


def not_compared(results: Results) -> Iterator[str]:
    """Which conditions have no parameters in common, and which have a model that does not suit."""
    if not {SUBJECT, CONDITION} <= {*results.fields}:
        yield "Conditions are not compared: that needs a pattern with {subject} and {condition}."
    for (stratum, conditions), (models, suits) in results.compared.items():
        words = " ".join((*stratum, ":".join(conditions)))
        if not models:
            yield (
                f"{words}: no model is determined in all these conditions; what means the same in "
                "every model is compared, parameters are not."
            )
        elif not suits:
            names = ", ".join(dict.fromkeys(models.values()))
            yield f"{words}: {names} describes one condition clearly worse than its own model does."


# ------------------------------------------------------------------------------ sensitivity


def sensitivity(results: Results) -> DataFrame:
    """Mean shifts of parameters that count, in claimed errors, by other ways to fit."""
    found = results.quantities
    found = found[(found["kind"] == PARAMETER) & (found[LEFT_OUT] == "") & found["run"].isna()]
    is_other = found["otherwise"] != ""
    names = ["file", "model", "method", "parameter"]
    both = found[is_other].merge(found.loc[~is_other, [*names, "value", "std_error"]], on=names)
    both["shift"] = (both["value_x"] - both["value_y"]) / both["std_error_y"]
    keys = [n for n in (*results.strata, CONDITION, "otherwise", "method") if n in both]
    return both.pivot_table("shift", keys, "parameter", sort=False).reset_index()
