"""The tables of an experiment, for its page, for papers and the terminal, and the page itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from pandas import DataFrame

from pilotid.estimate.quantities import symbol
from pilotid.experiment.comparisons import FACTOR_COLUMNS, POWER, SHARE, planned, sensitivity
from pilotid.experiment.figures import figures
from pilotid.experiment.files import in_order
from pilotid.experiment.results import Results
from pilotid.plots.page import FIGURES, save_figures, write_page
from pilotid.support.format import NONE, Table, latex, number, p_value, table, to_error, unsigned
from pilotid.support.jobs import about_this
from pilotid.support.numbers import LEVEL
from pilotid.support.remarks import counted_grades, gravest_first
from pilotid.support.types import printable

#: Quantities of signals that are shown first; all others are parts of them.
HEADLINES = ("var_e", "var_u", "remnant_share_u")
NEEDED = (
    f"Subjects with whom {100 * POWER:.0f} % of paired tests at 5 % find a difference of "
    f"{SHARE:.0f} %, by the spread of the differences measured here [%]"
)
SHIFTS = "Shifts of estimates in claimed errors, means over subjects, by other ways to fit"


def _interval(low: float, high: float, error: float) -> str:
    return f"[{to_error(low, error)}, {to_error(high, error)}]" if math.isfinite(low) else NONE


#: What writes numbers, by column; other columns hold words.
FORMS: Mapping[str, Callable[..., str]] = {
    **dict.fromkeys(("subjects", "freedom", "df1", "df2", "runs"), "{:.0f}".format),
    **dict.fromkeys(("vaf_size", "vaf_count"), "{:.0f}".format),
    **dict.fromkeys(("p", "p_holm", "wilcoxon_p", "p_corrected"), p_value),
    **dict.fromkeys(("t", "F", "effect_size", "vaf", "epsilon", "eta_squared", "spread"), number),
    **dict.fromkeys(("vaf_mean", "vaf_sem", "behind_mean", "behind_sem"), number),
    **dict.fromkeys(("difference", "interval_95", "robust_difference"), str),
}
TITLES = {
    "subjects": "n", "freedom": "df", "p_holm": "p Holm", "effect_size": "d_z",
    "interval_95": "95 % interval", "eta_squared": "partial eta²", "vaf_size": "runs",
    "vaf_count": "predicted",
}  # fmt: skip
#: Columns for the page, and for papers and the terminal.
TESTED = (
    *("method", "conditions", "model", "parameter", "unit", "subjects", "difference"),
    *("interval_95", "t", "freedom", "p", "p_holm", "effect_size", "robust_difference"),
    *("wilcoxon_p", "notes"),
)
PAPER = TESTED[:-3]
PREDICTED = ("vaf_size", "vaf_count", "vaf_mean", "vaf_sem", "behind_mean", "behind_sem")


# ---------------------------------------------------------------------------------- tables


def frame_table(frame: DataFrame, caption: str, columns: Sequence[str], heads: int) -> Table:
    """A row of text for each row of a frame.

    Parameters
    ----------
    frame, caption
        What is shown.
    columns
        The frame's columns, see `FORMS`.
    heads
        How many of them say what a row is about.
    """
    titles = {name: TITLES.get(name, name.replace("_", " ")) for name in columns}
    forms = {titles[name]: form for name, form in FORMS.items() if name in titles}
    rows = frame[[*columns]].itertuples(index=False, name=None)
    return table(rows, caption, [*titles.values()], forms, heads=heads)


def contrast_table(
    results: Results, frame: DataFrame, caption: str, columns: Sequence[str]
) -> Table:
    """A row for each contrast."""
    error, suits = frame["std_error"], frame["model_suits"].astype(bool)
    both = frame["model_a"] + ", " + frame["model_b"]
    model = frame["model_a"].where(frame["model_a"] == frame["model_b"], both)
    if not suits.all():
        caption += "; * describes one of the conditions clearly worse than its own model does"
    frame = frame.assign(
        model=model + np.where(suits, "", " *"),
        conditions=frame["condition_a"] + (":" + frame["condition_b"]),
        difference=[*map(unsigned, frame["difference"], error)],
        interval_95=[*map(_interval, frame["lower_95"], frame["upper_95"], error)],
        robust_difference=[*map(to_error, frame["robust_difference"], error)],
    )
    return frame_table(frame, caption, [*results.strata, *columns], len(results.strata) + 4)


def notable(frame: DataFrame) -> DataFrame:
    """Rows of parameters and loops, and of the signals' quantities that are shown first."""
    return frame[(frame["method"] != "measured") | frame["parameter"].isin(HEADLINES)]


def first_contrasts(results: Results, columns: Sequence[str]) -> Table:
    """The contrasts that are shown first: all of few pairs, or the significant."""
    shown, caption = notable(results.contrasts), "Differences b less a between conditions a:b"
    if shown.groupby(["condition_a", "condition_b"]).ngroups > 3:
        shown = shown[shown["p_holm"] < LEVEL]
        caption += f", with p < {LEVEL:g} after Holm's correction for the pairs"
    return contrast_table(results, shown, caption, columns)


def effect_table(results: Results) -> Table:
    """The effects of factors on quantities that are shown first."""
    caption = "Effects of the factors: repeated-measures analysis of variance"
    columns = [*results.strata, *FACTOR_COLUMNS[:-1]]  # notes are long, and in factors.csv
    return frame_table(notable(results.factors), caption, columns, len(results.strata) + 4)


def means_tables(results: Results) -> Iterator[Table]:
    """Quantities down, conditions across: means over subjects, or single values with their errors.

    Means have the standard deviation between subjects in parentheses.
    """
    for title, rows in results.groups():
        who = rows.groupby("condition")["subject"].nunique()
        conditions = in_order(who.index)
        cells = []
        for (parameter, unit), of_quantity in rows.groupby(["parameter", "unit"], sort=False):
            out = of_quantity[of_quantity["left_out"] != ""]
            missing = "; ".join(out["condition"] + " " + out["subject"] + " " + out["left_out"])
            means = (_cell(of_quantity[of_quantity["condition"] == c], who[c]) for c in conditions)
            cells.append((parameter, unit, *means, missing))
        models = rows.groupby("condition")["model"].first()
        heads = [
            f"{' '.join(filter(None, (c or 'all', models[c])))} (n = {who[c]})" for c in conditions
        ]
        titles = ("parameter", "unit", *heads, "not counted")
        yield table(cells, f"Estimates: {title}", titles, dict.fromkeys(heads, str))


def _cell(rows: DataFrame, subjects: int) -> str:
    """A mean with the standard deviation between subjects, or one value with its error."""
    known = rows[rows["left_out"] == ""]
    if not len(known):
        return NONE
    if subjects == 1:
        return unsigned(*map(float, known[["value", "std_error"]].iloc[0]))
    deviation = float(known["value"].std(ddof=1))
    fewer = f", n = {len(known)}" if len(known) < subjects else ""
    mean = to_error(float(known["value"].mean()), deviation)
    return f"{mean} ({to_error(deviation, deviation)}{fewer})"


def left_out_table(results: Results) -> Table:
    """Models and methods by the runs that they predict, within each kind of recording.

    ``behind`` is the log-likelihood of a run less that of the best that predicts it.
    """
    left, ways = results.left_out, [*results.strata, "condition", "model", "method"]
    best = left.groupby(["file", "run"])["log_likelihood"].transform("max")
    known = left.assign(behind=left["log_likelihood"] - best)
    frame = known.groupby(ways, sort=False)[["vaf", "behind"]].agg(["size", "count", "mean", "sem"])
    frame.columns = ["_".join(name) for name in frame.columns]
    caption = "Runs predicted by the fit of the others"
    return frame_table(frame.reset_index(), caption, [*ways, *PREDICTED], len(ways))


def fit_table(results: Results) -> Table:
    """Every recording, all runs together, with what is said of it and of its fits."""
    fits = results.usual[results.usual["method"] != "measured"]
    fits = fits.drop_duplicates(["file", "model", "method"])
    said = ["; ".join(f"[{r.code}] {r}" for r in gravest_first(of)) for of in fits["said"]]
    columns = ("recording", "model", "method", "runs", "vaf", "outcome", "remarks")
    caption = "Every recording, all runs together"
    outcome = fits["outcome"].where(fits["failure"] == "", fits["failure"])
    return frame_table(fits.assign(remarks=said, outcome=outcome), caption, columns, 1)


def tables_tex(results: Results) -> str:
    r"""Estimates, contrasts and effects as booktabs longtables without captions, for ``\input``."""
    caption = "Paired differences b less a over subjects; p Holm for the pairs of conditions"
    differences = contrast_table(results, results.contrasts, caption, PAPER)
    tables = filled(*means_tables(results), differences, effect_table(results))
    return "% Needs \\usepackage{booktabs,longtable}.\n" + "".join(
        f"% {printable(t.caption)}\n{latex(t, symbol)}\n" for t in tables
    )


def filled(*tables: Table) -> list[Table]:
    """The tables that have a row."""
    return [own for own in tables if own.rows]


# ------------------------------------------------------------------------------- sentences


def alarms(results: Results) -> Iterator[str]:
    """Why fits failed; how many remarks there are, each once a recording; the first of each."""
    lost = results.quantities[results.quantities["failure"] != ""]
    place = lost["recording"] + (" run " + lost["run"].astype("string")).fillna("")
    place += (" " + lost["otherwise"]).str.rstrip()
    for (method, model, _), own in lost.groupby(["method", "model", "outcome"], sort=False):
        where = _first(place[own.index].unique())
        yield f"{model} by {method}, {where}: {own['failure'].iloc[0]}."
    fits = results.quantities[results.quantities["method"] != "measured"]
    said = fits[["recording", "said"]].explode("said").dropna().drop_duplicates()
    if len(said):
        yield f"Warnings: {counted_grades(said['said'])}."
    grave = said[said["said"].map(lambda remark: remark.grade) != "note"]
    codes = grave["said"].map(lambda remark: (remark.grade, remark.code))
    firsts = {own.iloc[0]["said"]: own["recording"] for _, own in grave.groupby(codes, sort=False)}
    for first in gravest_first(firsts):
        yield f"{first.line(_first(firsts[first]))}."


def _first(places: Iterable[str]) -> str:
    place, *others = places
    return place + (f", and {len(others)} more" if others else "")


def not_compared(results: Results) -> Iterator[str]:
    """Which conditions have no model in which their parameters are compared, if there are any."""
    compared = results.compared
    lacking = compared[(compared["kind"] == "parameter") & (compared["model"] == "")]
    names = {
        " ".join((*of.iloc[0][:-1], ":".join(group[-1] for group in of))): None
        for _, of in lacking.groupby("comparison", sort=False)["group"]
    }
    if names:
        yield (
            f"{', '.join(names)}: no model is determined in all these conditions and suits them; "
            "what means the same in every model is compared, parameters are not."
        )


def summary(results: Results) -> Iterator[str]:
    """What a reader must know first, a sentence each."""
    every = results.contrasts
    found = every[every["p_holm"] < LEVEL].sort_values("p_holm")
    what = (found["parameter"] + " of " + found["condition_a"] + ":" + found["condition_b"])[:3]
    named = f", first {', '.join(dict.fromkeys(what))}" if len(found) else ""
    if len(every):
        yield f"{len(found)} of {len(every)} differences have p < {LEVEL:g} after Holm{named}."
    yield from (*alarms(results), *not_compared(results))


def choices(results: Results) -> Iterator[str]:
    """Why each model was chosen."""
    for group, choice in results.choices.items():
        if choice.reason:
            yield f"**{' '.join(group)}** {choice.reason}"


def blocks(results: Results) -> Iterator[str | Table]:
    """What the terminal shows."""
    yield from choices(results)
    yield from filled(first_contrasts(results, PAPER), effect_table(results))
    yield from (*alarms(results), *not_compared(results))


# -------------------------------------------------------------------------------- the page


def write_report(path: Path, results: Results, command: str) -> None:
    """Write the page, and its figures as SVG and PDF beside it.

    Parameters
    ----------
    path
        The page.
    results
        What it shows.
    command
        The command that made it.
    """
    drawings = [*figures(results)]
    save_figures(path.parent / FIGURES, drawings)
    strata, contrasts = results.strata, results.contrasts
    columns = [*strata, "method", "parameter", "spread", "subjects"]
    needed = frame_table(planned(contrasts, strata), NEEDED, columns, len(columns) - 2)
    main = [first_contrasts(results, TESTED), effect_table(results)]
    main += [left_out_table(results)] if len(results.left_out) else []
    shifts = sensitivity(results.quantities, strata)
    forms = dict.fromkeys(shifts.select_dtypes(float), "{:.1f}".format)
    otherwise = table(shifts.to_numpy(), SHIFTS, [*shifts], forms)
    write_page(
        path,
        "experiment.html",
        title="Pilot models of recorded subjects",
        results=results,
        summary=[*summary(results)],
        main=filled(*main),
        figures=drawings,
        choices=[*choices(results)],
        supplement=filled(needed, otherwise, *means_tables(results), fit_table(results)),
        command=command,
        about=about_this(results.settings.fitting.seed),
    )
