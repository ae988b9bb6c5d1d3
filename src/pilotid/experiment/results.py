"""Tidy frames of an experiment, and what follows from them: contrasts, effects of factors, power.

What is not determined does not count: an estimate at a bound, one whose interval spans more than a
factor of ten, one of a fit that failed or is graded wrong, as where the lines of the forcing
functions contradict it, and all of a recording that is graded wrong.  `LEFT_OUT` says why.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.experiment.cross_validation import COLUMNS as LEFT_OUT_COLUMNS
from pilotid.experiment.files import CONDITION, SUBJECT, in_order
from pilotid.experiment.fits import Fit, Fits, Group, candidates_of, group_of, remarks_of
from pilotid.experiment.statistics import anova, holm, paired, subjects_needed
from pilotid.support.numbers import LEVEL
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

#: The method of what signals show without any model.
MEASURED = "measured"
#: Why a value enters no mean, test or figure; empty if it does.
LEFT_OUT = "left_out"
#: Columns of estimates.csv and loops.csv behind the fields; the last is not written.
COLUMNS = (
    *("run", "model", "method", "parameter", "unit", "value", "std_error", "lower_95", "upper_95"),
    *("outcome", "remarks", "determined", LEFT_OUT),
)
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
MODEL_COLUMNS = (
    *("model", "chosen", "pilot_parameters", "parameters", "remnant", "samples", "log_likelihood"),
    *("aicc", "bic", "vaf", "left_out_vaf", "left_out_log_likelihood", "chi_squared", "freedom"),
    *("chi_squared_per_freedom", "left_out_chi_squared", "change_p", "change_size"),
    *("change_time", "remarks"),
)
#: A difference of this share is to be found this often by as many subjects as are needed.
SHARE, POWER = 0.15, 0.8


@dataclass(frozen=True, eq=False)
class Results:
    """All that tables and report show.

    Attributes
    ----------
    fits
        What was done.
    strata
        Fields of the pattern but subject and condition.
    estimates, loops
        A row for each quantity of each fit, `COLUMNS`; variances are among the estimates.
    contrasts, factors
        `CONTRAST_COLUMNS` and `FACTOR_COLUMNS` behind the strata's fields.
    notes
        What could not be worked out, a sentence each.
    """

    fits: Fits
    strata: list[str]
    estimates: DataFrame
    loops: DataFrame
    contrasts: DataFrame
    factors: DataFrame
    notes: Sequence[str]

    @cached_property
    def shown(self) -> DataFrame:
        """Quantities of all runs together by the model of each recording."""
        from pandas import concat

        both = concat([self.estimates, self.loops], ignore_index=True)
        own = {part.name: ("", *self.fits.models_of(part)) for part in self.fits.looks}
        chosen = [m in own[f] for f, m in zip(both["file"], both["model"], strict=True)]
        return both[np.array(chosen, dtype=bool) & both["run"].isna()]

    def groups(self) -> Iterator[tuple[str, DataFrame]]:
        """Quantities that share a table, of one stratum and method, and of one model if named."""
        auto = self.fits.settings.auto
        keys = [*self.strata, "method", *([] if auto else ["model"])]
        for key, own in self.shown.groupby(keys, sort=False):
            *words, method = key if auto else key[:-1]
            words.append("performance" if method == MEASURED else f"method `{method}`")
            yield (
                ", ".join([*words, *([f"model `{key[-1]}`"] if key[-1] and not auto else [])]),
                own,
            )

    @property
    def responses(self) -> DataFrame:
        """Coefficients at the lines of the recordings that count."""
        from pandas import DataFrame

        known = self.shown
        counted = {*known.loc[(known["method"] == MEASURED) & (known[LEFT_OUT] == ""), "file"]}
        rows = [
            (" ".join(fit.part.stratum), fit.part.field(CONDITION), *point)
            for fit in self.fits.fits
            if fit.part.name in counted
            and fit.content["model"] in self.fits.models_of(fit.part)[:1]
            for point in fit.content["responses"]
        ]
        columns = ["stratum", CONDITION, "channel", "omega", "real", "imag", "std"]
        return DataFrame(rows, columns=columns)

    @cached_property
    def models(self) -> DataFrame:
        """Rows of models.csv: each model compared on each recording."""
        from pandas import DataFrame

        rows = [
            {
                **{"file": part.name, **dict(part.fields), **asdict(c)},
                "chosen": "yes" if c.model == self.fits.choices[group_of(part)].model else "no",
                "freedom": c.freedom or None,
                "chi_squared_per_freedom": c.excess,
                "left_out_log_likelihood": sum(c.left_out_log_likelihood) or None,
                "left_out_chi_squared": sum(c.left_out_chi_squared) or None,
                "remarks": c.bounds,
            }
            for part, look in self.fits.looks.items()
            for c in candidates_of(look)
        ]
        return DataFrame(rows, columns=["file", *self.fits.fields, *MODEL_COLUMNS])

    @property
    def sensitivity(self) -> DataFrame:
        """Mean shifts of parameters that count, in claimed errors, by other ways to fit."""
        from pandas import DataFrame, concat

        heads = ["file", *self.fits.fields, "element", *COLUMNS]
        other = concat(
            DataFrame([*_rows(self.fits, "parameters", [fit])], columns=heads).assign(
                otherwise=word
            )
            for word, fit in self.fits.varied
        )
        names = ["file", "model", "method", "parameter"]
        both = other.merge(self.shown[[*names, "value", "std_error", LEFT_OUT]], on=names)
        both = both[(both[f"{LEFT_OUT}_x"] == "") & (both[f"{LEFT_OUT}_y"] == "")]
        both["shift"] = (both["value_x"] - both["value_y"]) / both["std_error_y"]
        keys = [n for n in (*self.strata, CONDITION, "otherwise", "method") if n in both]
        return both.pivot_table("shift", keys, "parameter", sort=False).reset_index()

    @property
    def left_out(self) -> DataFrame:
        """Rows of left_out.csv: each run that was predicted by the fit of the others."""
        from pandas import DataFrame

        rows = [
            {
                **{
                    "file": f.part.name,
                    **dict(f.part.fields),
                    "run": f.run,
                    "model": f.content["model"],
                },
                **own,
            }
            for f in self.fits.left_out
            for own in f.content["left_out"]
        ]
        return DataFrame(rows, columns=["file", *self.fits.fields, *LEFT_OUT_COLUMNS])


def results_of(fits: Fits) -> Results:
    """Work out what follows from fits.

    Raises
    ------
    InputError
        If a pair names a condition or a parameter that there is not.
    """
    from pandas import DataFrame, concat

    settings, parts, fields = fits.settings, [*fits.looks], fits.fields
    strata = [name for name in fields if name not in (SUBJECT, CONDITION)]
    heads = ["file", *fields, "element", *COLUMNS]
    measured, rows, loops = (
        DataFrame([*own], columns=heads).astype({"run": "Int64"})
        for own in (
            _measured(fits),
            _rows(fits, "parameters", fits.fits),
            _rows(fits, "loops", fits.fits),
        )
    )
    # Of a pilot who changes there is no loop, and nothing to show.
    loops = loops[loops.groupby(["model", "parameter"])["value"].transform("count") > 0]
    found, effects, notes = DataFrame(), DataFrame(), list[str]()
    if {SUBJECT, CONDITION} <= set(fields):
        keys = [*strata, CONDITION, SUBJECT, "model", "method", "parameter"]
        whole = measured[~measured["parameter"].str.startswith("rms_")]
        frames = [_cells(own, keys) for own in (whole, loops, rows)]
        named = {name for own in frames[1:] for name in own["parameter"]}
        conditions = {part.field(CONDITION) for part in parts}
        for pair in settings.pairs:
            _require(pair, conditions, named - conditions)
        tables = [
            dict(iter(frame.groupby([*strata, CONDITION, "model"], sort=False))) for frame in frames
        ]
        compared = DataFrame(
            [*_differences(fits, strata, tables)], columns=[*strata, *CONTRAST_COLUMNS]
        )
        found = _corrected(compared, fits, strata)
        if settings.factors is not None:
            tested = DataFrame([*_effects(fits, strata, tables)])
            effects = tested.reindex(columns=[*strata, *FACTOR_COLUMNS])
        notes += _not_compared(fits)
    elif settings.pairs:
        raise InputError(
            "--contrast: the pattern has no {subject} or no {condition}; contrasts are made "
            "between conditions over subjects"
        )
    else:
        notes.append(
            "Conditions are not compared: that needs a pattern with {subject} and {condition}."
        )
    estimates = concat([measured, rows], ignore_index=True)
    return Results(fits, strata, estimates, loops, found, effects, notes)


# ---------------------------------------------------------------------------------- frames


def _wrong(fits: Fits, told: Sequence[Sequence[str]]) -> str:
    """The first code of remarks that say not to use the numbers; empty if none does."""
    remarks = remarks_of(told, fits.settings.ignored)
    return next((remark.code for remark in remarks if remark.grade == "wrong"), "")


def _measured(fits: Fits) -> Iterator[list[object]]:
    """Rows of performance and control activity: means over the runs, and each run if so asked."""
    for part, look in fits.looks.items():
        wrong = "" if fits.settings.keep_all else _wrong(fits, look["remarks"])
        head = [part.name, *dict(part.fields).values(), ""]
        for key, unit, values in look["performance"]:
            count, mean = len(values), float(np.mean(values))
            error = float(np.std(values, ddof=1)) / math.sqrt(count) if count > 1 else math.nan
            reach = _t95(count - 1) * error if error > 0.0 else math.nan
            numbers = mean, error, mean - reach, mean + reach
            ends = MEASURED, "", True, wrong
            yield [*head, None, "", MEASURED, key, unit, *numbers, *ends]
            for run, value in enumerate(values if fits.settings.per_run and count > 1 else (), 1):
                yield [*head, run, "", MEASURED, key, unit, value, *[math.nan] * 3, *ends]


def _t95(freedom: int) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 1.0 - 0.5 * LEVEL))


def _rows(fits: Fits, what: str, of: Sequence[Fit]) -> Iterator[list[object]]:
    """Rows of the parameters or the loops of some fits."""
    told = {"parameters": "remarks", "loops": "loop_remarks"}[what]
    ignored, keep_all = fits.settings.ignored, fits.settings.keep_all
    for fit in of:
        head = [fit.part.name, *dict(fit.part.fields).values(), fit.content["element"], fit.run]
        recording = _wrong(fits, fits.looks[fit.part]["remarks"])
        for e in fit.content["estimates"]:
            remarks = [*remarks_of(e[told], ignored)]
            wrong = recording or _wrong(fits, [*e["remarks"], *e["loop_remarks"]])
            for key, unit, *numbers, determined, why in e[what]:
                out = "" if keep_all else wrong or why
                if not e["usable"]:
                    out = e["outcome"]
                elif not math.isfinite(numbers[0]):
                    out = out or "no value"
                said = [*([f"not counted: {out}"] if out else []), *remarks]
                yield [
                    *(*head, fit.content["model"], e["method"], key, unit, *numbers),
                    *(e["outcome"], " | ".join(said), determined, out),
                ]


def _cells(frame: DataFrame, keys: Sequence[str]) -> DataFrame:
    """The value of each subject in each condition: the mean over recordings if there are more."""
    known = frame[frame["run"].isna()]
    known = known.assign(value=known["value"].where(known[LEFT_OUT] == ""))
    own = known.groupby([*keys], sort=False)
    found = own.agg(
        unit=("unit", "first"), value=("value", "mean"), **{LEFT_OUT: (LEFT_OUT, "max")}
    )
    return found.reset_index()


# ------------------------------------------------------------------------------- contrasts

#: Cells by stratum, condition and model: of signals, of loops, of parameters.
Tables = Sequence[Mapping[tuple[str, ...], "DataFrame"]]


def _require(pair: tuple[str, str], conditions: set[str], parameters: set[str]) -> None:
    """Refuse a pair that is neither of two conditions nor of two parameters."""
    text = ":".join(pair)
    if pair[0] == pair[1]:
        raise InputError(f"the contrast {text} names one thing twice; name two")
    if not (set(pair) <= conditions or set(pair) <= parameters):
        raise InputError(
            f"the contrast {text} is neither of two conditions, which are "
            f"{', '.join(in_order([*conditions]))}, nor of two parameters of one model"
        )


def _models(fits: Fits, place: int, stratum: Group, own: Group) -> list[Mapping[str, str]]:
    """The models of the conditions, for cells of a kind: 0 signals, 1 loops, 2 parameters."""
    if not place:
        return [dict.fromkeys(own, "")]
    if not fits.settings.auto:
        return [dict.fromkeys(own, name) for name in fits.settings.models]
    if place == 1:  # crossover and margin mean the same in any model
        return [{c: fits.choices[(*stratum, c)].model for c in own}]
    models, _ = fits.compared[stratum, own]
    return [models] if models else []


def _strata(fits: Fits) -> dict[Group, list[str]]:
    """The conditions of each stratum."""
    found: dict[Group, list[str]] = {}
    for part in fits.looks:
        found.setdefault(part.stratum, []).append(part.field(CONDITION))
    return {stratum: in_order(own) for stratum, own in found.items()}


def _comparisons(fits: Fits) -> Iterator[tuple[Group, int, Group, Mapping[str, str], Group]]:
    """What is compared, quantities that mean the same in every model first.

    The stratum, the kind of cells, two conditions, their models, and two parameters or none.
    """
    for stratum, conditions in _strata(fits).items():
        for place in range(3):
            for pair in fits.settings.condition_pairs(conditions):
                for models in _models(fits, place, stratum, pair):
                    yield stratum, place, pair, models, ()
    for stratum, conditions in _strata(fits).items():
        for pair in fits.settings.pairs:
            for place, own in product((1, 2), conditions if {*pair}.isdisjoint(conditions) else ()):
                for models in _models(fits, 1, stratum, (own,)):
                    yield stratum, place, (own, own), models, pair


def _differences(fits: Fits, strata: Sequence[str], tables: Tables) -> Iterator[dict[str, Any]]:
    """A row for each quantity that both sides of a comparison have."""
    for stratum, place, (a, b), models, keys in _comparisons(fits):
        sides = [tables[place].get((*stratum, c, models[c])) for c in (a, b)]
        known = [side for side in sides if side is not None]
        if len(known) < 2:
            continue
        if keys:
            name = " - ".join(reversed(keys))
            known = [
                own[own["parameter"] == key].assign(parameter=name)
                for own, key in zip(known, keys, strict=True)
            ]
        one, two = (own.set_index(["method", "parameter"]) for own in known)
        for key in one.index.drop_duplicates():
            if key in two.index:
                head = (*stratum, a, b, models[a], models[b], *key)
                yield _contrast(strata, head, one.loc[[key]], two.loc[[key]])


def _contrast(
    strata: Sequence[str], head: Sequence[str], one: DataFrame, two: DataFrame
) -> dict[str, Any]:
    """One difference, with the subjects that count and why others do not."""
    found: dict[str, Any] = dict(zip((*strata, *CONTRAST_COLUMNS), head, strict=False))
    both = one.merge(two, "outer", SUBJECT, suffixes=("_a", "_b")).set_index(SUBJECT)
    both = both.loc[in_order([*both.index])]
    whole = both[["value_a", "value_b"]].dropna()
    units = dict.fromkeys([*one["unit"], *two["unit"]])
    notes, out = [], []
    for subject, row in both.drop(index=whole.index).iterrows():
        for side in "ab":
            condition, why = found[f"condition_{side}"], row[f"{LEFT_OUT}_{side}"]
            if isinstance(why, float):  # the subject has no such cell
                out.append(f"subject {subject}, no recording in {condition}")
            elif why:
                out.append(f"subject {subject}, {found['parameter']} {why} in {condition}")
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
    return found | numbers | {"unit": ", ".join(units), "notes": " | ".join(notes)}


def _corrected(frame: DataFrame, fits: Fits, strata: Sequence[str]) -> DataFrame:
    """The contrasts by quantity, with Holm's p for the pairs, and the interval of the same level.

    A disturbance loop that is the target loop, as without motion, is left out.
    """
    from scipy.special import stdtrit

    quantity = [*strata, "method", "parameter", *([] if fits.settings.auto else ["model_a"])]
    ends = frame[[*strata, *CONTRAST_COLUMNS[:6], "mean_a", "mean_b"]].round(9)
    loops = ends["parameter"].str.replace("^(target|disturbance)_", "", regex=True)
    frame = frame[~ends.assign(parameter=loops).duplicated()]
    order = frame.groupby(quantity, sort=False).ngroup()
    frame = frame.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)
    p_holm = frame.groupby(quantity, sort=False)["p"].transform(holm)
    level = 1.0 - 0.5 * LEVEL * (frame["p"] / p_holm).astype(float)
    reach = stdtrit(frame["freedom"].astype(float), level) * frame["std_error"]
    low, high = frame["difference"] - reach, frame["difference"] + reach
    return frame.assign(p_holm=p_holm, lower_holm_95=low, upper_holm_95=high)


def planned(results: Results) -> DataFrame:
    """How many subjects a difference of `SHARE` takes, by the spread of differences measured here.

    Columns: the stratum's fields, method, parameter, ``spread`` (standard deviation of the paired
    differences over the mean, root mean square over the pairs), ``subjects`` (NaN: over 1000).
    """
    found = results.contrasts
    known = found[found["t"].notna() & (found["condition_a"] != found["condition_b"])]
    size = 0.5 * (known["mean_a"] + known["mean_b"])
    known = known.assign(spread=known["subjects"] * (known["std_error"] / size) ** 2)
    keys = [*results.strata, "method", "parameter"]
    own = known.groupby(keys, sort=False)["spread"].mean().pow(0.5).reset_index()
    return own.assign(subjects=[subjects_needed(SHARE / s, POWER) for s in own["spread"]])


# --------------------------------------------------------------------------------- factors


def _effects(fits: Fits, strata: Sequence[str], tables: Tables) -> Iterator[dict[str, Any]]:
    """Effects of the factors on each quantity, of parameters in models that suit all conditions."""
    from pandas import concat

    factors = fits.settings.factors
    assert factors is not None
    levels = [[*dict.fromkeys(factors[name])] for name in factors]
    by_cell = dict(zip(factors.itertuples(index=False, name=None), factors.index, strict=True))
    conditions = [by_cell[cell] for cell in product(*levels)]
    shape = [len(own) for own in levels]
    for stratum, there in _strata(fits).items():
        for place, table in enumerate(tables if {*conditions} <= {*there} else ()):
            for models in _models(fits, place, stratum, tuple(factors.index)):
                places = [(*stratum, c, models[c]) for c in conditions]
                if not {*places} <= {*table}:
                    continue
                whole = concat([table[place] for place in places])
                for key, own in whole.groupby(["method", "parameter"], sort=False):
                    head = dict(zip((*strata, *FACTOR_COLUMNS), (*stratum, *key), strict=False))
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


def _not_compared(fits: Fits) -> Iterator[str]:
    """Which conditions have no parameters in common, and which have a model that does not suit."""
    for (stratum, conditions), (models, suits) in fits.compared.items():
        words = " ".join((*stratum, ":".join(conditions)))
        if not models:
            yield (
                f"{words}: no model is determined in all these conditions; what means the same in "
                "every model is compared, parameters are not."
            )
        elif not suits:
            names = ", ".join(dict.fromkeys(models.values()))
            yield f"{words}: {names} describes one condition clearly worse than its own model does."
