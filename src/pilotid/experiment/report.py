"""The tables of an experiment, for its page, for papers and the terminal, and the page itself."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from pandas import DataFrame

from pilotid.estimate.quantities import UNDETERMINED, symbol
from pilotid.experiment.comparisons import POWER, SHARE, not_compared, planned, sensitivity
from pilotid.experiment.figures import figures
from pilotid.experiment.files import in_order
from pilotid.experiment.results import Results
from pilotid.plots.page import FIGURES, save_figures, write_page
from pilotid.support.format import NONE, Table, latex, number, p_value, table, to_error, unsigned
from pilotid.support.jobs import about_this
from pilotid.support.numbers import LEVEL
from pilotid.support.remarks import counted_grades, gravest_first
from pilotid.support.types import printable

FEW = 3  # pairs of which all differences are shown first
#: Quantities of signals that are shown first; all others are parts of them.
HEADLINES = ("var_e", "var_u", "remnant_share_u")
SHIFTS = "Shifts of estimates in claimed errors, means over subjects, by other ways to fit"


def _interval(low: float, high: float, error: float) -> str:
    return f"[{to_error(low, error)}, {to_error(high, error)}]" if math.isfinite(low) else NONE


#: What writes numbers, by column; other columns hold words.
FORMS: Mapping[str, Callable[..., str]] = {
    **dict.fromkeys(("subjects", "freedom", "df1", "df2", "runs", "failed"), "{:.0f}".format),
    **dict.fromkeys(("p", "p_holm", "wilcoxon_p", "p_corrected"), p_value),
    **dict.fromkeys(("t", "F", "effect_size", "vaf", "epsilon", "eta_squared", "spread"), number),
    **dict.fromkeys(("difference", "interval_95", "robust_difference", "vaf_mean", "behind"), str),
}
TITLES = {
    "subjects": "n", "freedom": "df", "p_holm": "p Holm", "effect_size": "d_z",
    "interval_95": "95 % interval", "eta_squared": "partial eta²", "vaf_mean": "vaf",
}  # fmt: skip
#: Columns for the page, and for papers and the terminal.
TESTED = (
    *("method", "conditions", "model", "parameter", "unit", "subjects", "difference"),
    *("interval_95", "t", "freedom", "p", "p_holm", "effect_size", "robust_difference"),
    *("wilcoxon_p", "notes"),
)
PAPER = TESTED[:-3]
EFFECTS = (
    *("method", "parameter", "effect", "subjects", "F", "df1", "df2", "epsilon", "p_corrected"),
    "eta_squared",
)
PREDICTED = ("model", "method", "runs", "failed", "vaf_mean", "behind")


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


def notable_contrasts(results: Results) -> tuple[DataFrame, str]:
    """The contrasts that are shown first, all of few pairs or the significant, and a caption."""
    shown, caption = notable(results.contrasts), "Differences b less a between conditions a:b"
    if shown.groupby(["condition_a", "condition_b"]).ngroups > FEW:
        shown = shown[shown["p_holm"] < LEVEL]
        caption += f", with p < {LEVEL:g} after Holm's correction for the pairs"
    return shown, caption


def effect_table(results: Results) -> Table:
    """The effects of factors on quantities that are shown first."""
    caption = "Effects of the factors: repeated-measures analysis of variance"
    strata = results.strata
    return frame_table(notable(results.factors), caption, [*strata, *EFFECTS], len(strata) + 3)


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
        if models.nunique() > 1:
            title += "; models: " + ", ".join(f"{c} `{models[c]}`" for c in conditions)
        heads = [f"{c or 'all'} (n = {who[c]})" for c in conditions]
        titles = ("parameter", "unit", *heads, "not counted")
        yield table(cells, f"Estimates: {title}", titles, dict.fromkeys(heads, str))


def _cell(rows: DataFrame, subjects: int) -> str:
    """A mean with the standard deviation between subjects, or one value with its error."""
    known = rows[rows["left_out"] == ""]
    if not len(known):
        return UNDETERMINED if len(rows) else NONE
    if subjects == 1:
        return unsigned(*map(float, known[["value", "std_error"]].iloc[0]))
    deviation = float(known["value"].std(ddof=1))
    fewer = f", n = {len(known)}" if len(known) < subjects else ""
    mean = to_error(float(known["value"].mean()), deviation)
    return f"{mean} ({to_error(deviation, deviation)}{fewer})"


def ranked(left: DataFrame) -> DataFrame:
    """Models and methods by the likelihood of runs left out, the best first.

    Methods whose fits fail in more than half of the runs come last and are not compared run by
    run, so that they do not cost the others theirs.

    Parameters
    ----------
    left
        Rows of left_out.csv of recordings of one kind.

    Returns
    -------
    DataFrame
        By model and method ``runs`` and ``failed`` fits; ``vaf_mean`` and ``behind``, the mean
        log-likelihood of a run less that of the best, over the runs that all predict, each with its
        standard error.
    """
    ways = ["model", "method"]
    table = left.pivot(index=["file", "run"], columns=ways, values="log_likelihood").astype(float)
    able = table[table.columns[2 * table.count() >= len(table)]].dropna()
    apart = able.sub(able[able.sum().idxmax()], axis=0) if able.size else able
    vaf = left.groupby(ways, sort=False)["vaf"]
    return (
        vaf.agg(runs="size", vaf_mean="mean", vaf_error="sem")
        .assign(failed=vaf.size() - vaf.count())
        .assign(behind=apart.mean(), behind_error=apart.sem().where(apart.mean() < 0.0))
        .sort_values("behind", ascending=False, na_position="last")
        .reset_index()
    )


def left_out_table(results: Results) -> Table:
    """Models and methods by the runs that they predict, within each kind of recording."""
    kinds = [*results.strata, "condition"]
    left = results.left_out.groupby(kinds, sort=False)
    frame = left.apply(ranked, include_groups=False).reset_index(kinds)
    frame = frame.assign(vaf_mean=[*map(unsigned, frame["vaf_mean"], frame["vaf_error"])])
    frame = frame.assign(behind=[*map(unsigned, frame["behind"], frame["behind_error"])])
    caption = "Runs predicted by the fit of the others, the likeliest first"
    return frame_table(frame, caption, [*kinds, *PREDICTED], len(kinds) + 2)


def fit_table(results: Results) -> Table:
    """Every recording, all runs together, with what is said of it and of its fits."""
    fits = results.fits
    said = ["; ".join(f"[{r.code}] {r}" for r in gravest_first(of)) for of in fits["said"]]
    columns = ("recording", "model", "method", "runs", "vaf", "outcome", "remarks")
    caption = "Every recording, all runs together"
    return frame_table(fits.assign(remarks=said), caption, columns, 1)


def tables_tex(results: Results, made_by: str = "") -> str:
    r"""Estimates, contrasts and effects as booktabs longtables without captions, for ``\input``.

    Parameters
    ----------
    results
        What was found.
    made_by
        The command that made them, for the comment at the head.
    """
    caption = "Paired differences b less a over subjects; p Holm for the pairs of conditions"
    differences = contrast_table(results, results.contrasts, caption, PAPER)
    tables = filled(*means_tables(results), differences, effect_table(results))
    head = f"% Made by: {printable(made_by or 'pilotid.analyse')}\n"
    head += "% Needs \\usepackage{booktabs,longtable}.\n"
    return head + "".join(f"% {printable(t.caption)}\n{latex(t, symbol)}\n" for t in tables)


def filled(*tables: Table) -> list[Table]:
    """The tables that have a row."""
    return [own for own in tables if own.rows]


# ------------------------------------------------------------------------------- sentences


def alarms(results: Results) -> Iterator[str]:
    """How many remarks there are, each once a recording, and the first of each code not a note."""
    rows = results.quantities
    said = rows.loc[rows["method"] != "measured", ["recording", "said"]].explode("said").dropna()
    said = said.drop_duplicates()
    if len(said):
        yield f"Warnings: {counted_grades(said['said'])}."
    grave = said[said["said"].map(lambda remark: remark.grade) != "note"]
    codes = grave["said"].map(lambda remark: remark.code)
    firsts = {own.iloc[0]["said"]: own["recording"] for _, own in grave.groupby(codes, sort=False)}
    for first in gravest_first(firsts):
        place, *others = firsts[first]
        yield f"{first.line(place + (f', and {len(others)} more' if others else ''))}."


def summary(results: Results) -> Iterator[str]:
    """What a reader must know first, a sentence each."""
    contrasts = results.contrasts
    if len(contrasts):
        quantities = contrasts.groupby([*results.strata, "method", "parameter"]).ngroups
        first, _ = notable_contrasts(results)
        yield (
            f"{(contrasts['p_holm'] < LEVEL).sum()} of {len(contrasts)} differences have "
            f"p < {LEVEL:g} (Holm's correction is for the pairs, not for the number of "
            f"quantities: by chance about {LEVEL * quantities:.2g} of {quantities} would). The "
            f"table has {len(first)} of parameters, loops, {', '.join(HEADLINES)}; `contrasts.csv` "
            "has all."
        )
    shown = [rows["left_out"] != "" for _, rows in results.groups()]
    if out := sum(int(missing.sum()) for missing in shown):
        yield (
            f"{out} of {sum(map(len, shown))} estimates count in no mean, test or figure "
            "(`--keep-all` counts them); the last column of their table says which and why."
        )
    ends = [f"{count} {outcome}" for outcome, count in Counter(results.fits["outcome"]).items()]
    yield f"Fits: {', '.join(ends) or 'none'}."
    yield from (*alarms(results), *not_compared(results))


def choices(results: Results) -> Iterator[str]:
    """Why each model was chosen."""
    for group, choice in results.choices.items():
        if choice.reason:
            yield f"**{' '.join(group)}** {choice.reason}"


def blocks(results: Results) -> Iterator[str | Table]:
    """What the terminal shows."""
    yield from choices(results)
    yield from filled(contrast_table(results, *notable_contrasts(results), PAPER))
    yield from filled(effect_table(results))
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
    caption = (
        f"Subjects with whom {100 * POWER:.0f} % of paired tests at 5 % find a difference of "
        f"{SHARE:.0f} %, by the spread of the differences measured here [%]"
    )
    columns = [*results.strata, "method", "parameter", "spread", "subjects"]
    needed = frame_table(planned(results), caption, columns, len(columns) - 2)
    main = [contrast_table(results, *notable_contrasts(results), TESTED), effect_table(results)]
    main += [left_out_table(results)] if len(results.left_out) else []
    shifts = sensitivity(results)
    forms = dict.fromkeys(shifts.select_dtypes(float), "{:.1f}".format)
    otherwise = table(shifts.to_numpy(), SHIFTS, [*shifts], forms)
    about = about_this(results.settings.fitting.seed)
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
        versions=[f"{k} {v}" for k, v in about.items() if k not in ("seed", "code")],
    )
