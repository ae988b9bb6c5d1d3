"""The tables of an experiment, for its page, for papers and the terminal, and the page itself."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pilotid.estimate.quantities import UNDETERMINED, symbol
from pilotid.experiment.comparisons import POWER, SHARE, not_compared, planned, sensitivity
from pilotid.experiment.cross_validation import ranked
from pilotid.experiment.figures import estimates_figure, responses_figure, variances_figure
from pilotid.experiment.files import CONDITION, SUBJECT, in_order
from pilotid.experiment.results import LEFT_OUT, MEASURED, Results
from pilotid.report.page import FIGURES, Figure, save_figures, write_page
from pilotid.study.study import about_this
from pilotid.support.format import (
    NONE,
    Table,
    latex,
    number,
    p_value,
    percent,
    plus_minus,
    table,
    to_error,
    unsigned,
)  # fmt: skip
from pilotid.support.numbers import LEVEL
from pilotid.support.remarks import GRADES, OF_STICK, Remark, counted_grades, gravest_first
from pilotid.support.types import printable

if TYPE_CHECKING:
    from pandas import DataFrame

FEW = 3  # pairs of which all differences are shown first
#: Quantities of signals that are shown first; all others are parts of them.
HEADLINES = ("var_e", "var_u", "remnant_share_u")


def _interval(low: float, high: float, error: float) -> str:
    return f"[{to_error(low, error)}, {to_error(high, error)}]" if math.isfinite(low) else NONE


#: Columns of frames: title, further columns that the text needs, what writes it; words but these.
COLUMNS: Mapping[str, tuple[str, tuple[str, ...], Callable[..., str]]] = {
    "subjects": ("n", (), "{:.0f}".format),
    "difference": ("difference", ("std_error",), unsigned),
    "lower_holm_95": ("95 % interval", ("upper_holm_95", "std_error"), _interval),
    "t": ("t", (), "{:.2f}".format),
    "freedom": ("df", (), "{:.0f}".format),
    "p": ("p", (), p_value),
    "p_holm": ("p Holm", (), p_value),
    "effect_size": ("d_z", (), number),
    "robust_difference": ("robust", ("std_error",), to_error),
    "wilcoxon_p": ("p ranks", (), p_value),
    "F": ("F", (), number),
    "df1": ("df1", (), "{:.0f}".format),
    "df2": ("df2", (), "{:.0f}".format),
    "epsilon": ("epsilon", (), number),
    "p_corrected": ("p corrected", (), p_value),
    "eta_squared": ("partial eta²", (), number),
    "spread": ("spread %", (), percent),
    "runs": ("runs", (), str),
    "failed": ("failed", (), str),
    "vaf": ("VAF %", (), number),
    "vaf_mean": ("VAF %", ("vaf_error",), unsigned),
    "behind": ("likelihood", ("behind_error",), plus_minus),
    "halves_percent": ("halves %", (), number),
    "halves_z": ("halves / error", (), number),
}
TESTED = (
    *("method", "conditions", "parameter", "unit", "subjects", "difference", "lower_holm_95"),
    *("t", "freedom", "p", "p_holm", "effect_size", "robust_difference", "wilcoxon_p"),
)
#: The same for papers and for the terminal.
PAPER = TESTED[:-2]
BRIEF = tuple(name for name in PAPER if name != "lower_holm_95")
EFFECTS = (
    *("method", "parameter", "effect", "subjects", "F", "df1", "df2", "epsilon", "p_corrected"),
    "eta_squared",
)
PREDICTED = (
    *("model", "method", "runs", "failed", "vaf_mean", "behind", "halves_percent", "halves_z"),
)


# ---------------------------------------------------------------------------------- tables


def frame_table(frame: DataFrame, caption: str, columns: Sequence[str], heads: int) -> Table:
    """A row of text for each row of a frame; p-values that are significant are marked.

    Parameters
    ----------
    frame, caption
        What is shown.
    columns
        The frame's columns, see `COLUMNS`.
    heads
        How many of them say what a row is about.
    """
    known = {name: COLUMNS[name] for name in columns if name in COLUMNS}
    every = [[name, *(known[name][1] if name in known else ())] for name in columns]
    cells = [
        [row[names[0]] if len(names) == 1 else tuple(row[n] for n in names) for names in every]
        for row in frame.to_dict("records")
    ]
    titles = [known[name][0] if name in known else name for name in columns]
    forms = {title: form for title, _, form in known.values()}
    marks = {
        known[name][0]: ["good" if p < LEVEL else "" for p in frame[name]]
        for name in ("p_holm", "p_corrected")
        if name in columns
    }
    return table(cells, caption, titles, forms, heads=heads, marks=marks)


def contrast_table(
    results: Results, found: DataFrame, caption: str, columns: Sequence[str]
) -> Table:
    """A row for each contrast."""
    found = found.assign(conditions=found["condition_a"] + (":" + found["condition_b"]))
    columns = [*results.strata, *columns]
    return frame_table(found, caption, columns, len(results.strata) + 3)


def notable(frame: DataFrame) -> DataFrame:
    """Rows of parameters and loops, and of the signals' quantities that are shown first."""
    return frame[(frame["method"] != MEASURED) | frame["parameter"].isin(HEADLINES)]


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
        place = CONDITION if CONDITION in rows else "file"
        who = rows.groupby(place)[SUBJECT if SUBJECT in rows else "file"].nunique()
        conditions = in_order([*who.index])
        cells = []
        for (parameter, unit), own in rows.groupby(["parameter", "unit"], sort=False):
            out = own[own[LEFT_OUT] != ""]
            why = [place, *([SUBJECT] if SUBJECT in out else []), LEFT_OUT]
            missing = "; ".join(map(" ".join, out[why].itertuples(index=False)))
            means = (_cell(own[own[place] == c], int(who[c])) for c in conditions)
            cells.append((parameter, unit, *means, missing))
        models = rows.groupby(place)["model"].first()
        if models.nunique() > 1:
            title += "; models: " + ", ".join(f"{c} `{models[c]}`" for c in conditions)
        heads = [f"{c or 'all'} (n = {who[c]})" for c in conditions]
        titles = ("parameter", "unit", *heads, "not counted")
        yield table(cells, f"Estimates: {title}", titles, dict.fromkeys(heads, str))


def _cell(own: DataFrame, subjects: int) -> str:
    """A mean with the standard deviation between subjects, or one value with its error."""
    known = own[own[LEFT_OUT] == ""]
    if not len(known):
        return UNDETERMINED if len(own) else NONE
    if subjects == 1:
        return unsigned(*map(float, known[["value", "std_error"]].iloc[0]))
    deviation = float(known["value"].std(ddof=1))
    fewer = f", n = {len(known)}" if len(known) < subjects else ""
    mean = to_error(float(known["value"].mean()), deviation)
    return f"{mean} ({to_error(deviation, deviation)}{fewer})"


def left_out_table(results: Results) -> Table:
    """Models and methods by the runs that they predict, within each kind of recording."""
    from pandas import concat

    kinds = results.kinds
    found = concat(
        ranked(rows).assign(**dict(zip(kinds, key, strict=True)))
        for key, rows in results.left_out.groupby(kinds, sort=False)
    )
    caption = "Runs predicted by the fit of the others, the likeliest first"
    return frame_table(found, caption, [*kinds, *PREDICTED], len(kinds) + 2)


def fit_table(results: Results) -> Table:
    """Every recording, all runs together, with what is said of it and of its fits."""
    fits = results.fits[results.fits["run"].isna() & (results.fits["otherwise"] == "")]
    said = [
        "; ".join(f"[{r.code}] {r}" for r in gravest_first(own) if r.code not in OF_STICK)
        for own in fits["told"]
    ]
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
    tables = [*means_tables(results)]
    if len(results.contrasts):
        caption = "Paired differences b less a over subjects; p Holm for the pairs of conditions"
        tables.append(contrast_table(results, results.contrasts, caption, PAPER))
    if len(results.factors):
        tables.append(effect_table(results))
    head = f"% Made by: {printable(made_by or 'pilotid.analyse')}\n"
    head += "% Needs \\usepackage{booktabs,longtable}.\n"
    return head + "".join(f"% {printable(own.caption)}\n{latex(own, symbol)}\n" for own in tables)


# ------------------------------------------------------------------------------- sentences


def alarms(results: Results, worst: int = 3) -> Iterator[str]:
    """How many remarks there are, each once a recording, and the worst of them."""
    told = zip(results.fits["recording"], results.fits["told"], strict=True)
    every = {(recording, remark): None for recording, remarks in told for remark in remarks}
    if graded := counted_grades(remark for _, remark in every if remark.code not in OF_STICK):
        yield f"Warnings: {graded}."
    counts = Counter((remark.code, remark.grade) for _, remark in every)
    first: dict[str, tuple[str, Remark]] = {}
    for place, remark in sorted(every, key=lambda own: GRADES.index(own[1].grade)):
        first.setdefault(remark.code, (place, remark))
    grave = [c for c, (_, r) in first.items() if r.grade != "note" and c not in OF_STICK]
    for code in (*grave[:worst], *(code for code in OF_STICK if code in first)):
        place, remark = first[code]
        alike = counts[code, remark.grade]
        more = f", and {alike - 1} more" if alike > 1 else ""
        yield f"{remark.line(place + more)}."
    if ignored := results.settings.ignored:
        yield f"Left out by --ignore: {', '.join(sorted(ignored))}."


def summary(results: Results) -> Iterator[str]:
    """What a reader must know first, a sentence each."""
    found, shown = results.contrasts, results.shown
    if len(found):
        quantities = found.groupby([*results.strata, "method", "parameter"]).ngroups
        yield (
            f"{(found['p_holm'] < LEVEL).sum()} of {len(found)} differences have p < {LEVEL:g} "
            "(Holm's correction is for the pairs, not for the number of quantities: by chance "
            f"about {LEVEL * quantities:.2g} of {quantities} would)."
        )
    if out := int((shown[LEFT_OUT] != "").sum()):
        yield (
            f"{out} of {len(shown)} estimates count in no mean, test or figure (`--keep-all` "
            "counts them); the last column of their table says which and why."
        )
    fits = results.fits
    ends = Counter(fits.loc[fits["otherwise"] == "", "outcome"])
    yield f"Fits: {', '.join(f'{count} {outcome}' for outcome, count in ends.items())}."
    yield from (*alarms(results), *not_compared(results))


def choices(results: Results) -> Iterator[str]:
    """Why each model was chosen."""
    for group, choice in results.choices.items():
        if choice.reason and (results.settings.auto or len(results.settings.models) > 1):
            yield f"**{' '.join(group)}** {choice.reason}"


def blocks(results: Results) -> Iterator[str | Table]:
    """What the terminal shows."""
    yield from choices(results)
    if len(results.contrasts):
        yield contrast_table(results, *notable_contrasts(results), BRIEF)
    if len(results.factors):
        yield effect_table(results)
    yield from (*alarms(results), *not_compared(results))


# -------------------------------------------------------------------------------- the page


def write_report(path: Path, results: Results, command: str) -> None:
    """Write the page, and its figures as SVG and PDF beside it.

    Parameters
    ----------
    path
        The page.
    results
        What was found.
    command
        The command that made it.
    """
    figures = [*_figures(results)]
    save_figures(path.parent / FIGURES, figures)
    main, supplement, missing = list[Table](), list[Table](), list[str]()
    if len(results.contrasts):
        shown, caption = notable_contrasts(results)
        main.append(contrast_table(results, shown, caption, TESTED))
        keys = [*results.strata, "condition_a", "condition_b", "parameter", "notes"]
        rows = shown.loc[shown["notes"] != "", keys].itertuples(index=False, name=None)
        missing += [f"{' '.join(dict.fromkeys(row[:-1]))}: {row[-1]}" for row in rows]
        caption = (
            f"Subjects with whom {100 * POWER:.0f} % of paired tests at 5 % find a difference of "
            f"{100 * SHARE:.0f} %, by the spread of the differences measured here"
        )
        columns = [*results.strata, "method", "parameter", "spread", "subjects"]
        supplement.append(frame_table(planned(results), caption, columns, len(columns) - 2))
    if len(results.factors):
        main.append(effect_table(results))
    if len(results.left_out):
        main.append(left_out_table(results))
    if results.settings.sensitivity:
        caption = "Shifts of estimates in claimed errors, means over subjects, by other ways to fit"
        shifts = sensitivity(results)
        forms = dict.fromkeys(shifts.select_dtypes(float), "{:.1f}".format)
        supplement.append(table(shifts.to_numpy(), caption, [*shifts], forms))
    supplement += [*means_tables(results), fit_table(results)]
    about = about_this(results.settings.seed)
    write_page(
        path,
        "experiment.html",
        title="Pilot models of recorded subjects",
        contents=[("summary", "Summary"), ("results", "Results"), ("supplement", "Supplement")],
        parts=results.parts,
        summary=[*summary(results)],
        excluded=[part.words for part in results.settings.excluded],
        refused=results.refused,
        main=main,
        missing=missing,
        figures=figures,
        choices=[*choices(results)],
        supplement=supplement,
        command=command,
        versions=[f"{name} {own}" for name, own in about.items() if name not in ("seed", "code")],
    )


def _figures(results: Results) -> Iterator[Figure]:
    """Variances, group responses and estimates of each stratum and method."""
    if not {SUBJECT, CONDITION} <= {*results.fields}:
        return
    drawn = []
    for title, own in results.groups():
        if own["method"].iloc[0] == MEASURED:
            words = f"What variances are made of, {title}: means over subjects, 95 % intervals."
            drawn.append(("variances", variances_figure(own), words))
    for stratum, own in results.responses.groupby("stratum", sort=False):
        words = (
            f"{', '.join(filter(None, ['Responses at the forcing lines', stratum]))}: means over "
            "subjects, in which coefficients that are poorly known weigh little, 95 % intervals; "
            "no model of the pilot."
        )
        drawn.append(("responses", responses_figure(own), words))
    for title, own in results.groups():  # the tall ones last, for fewer pages
        if own["method"].iloc[0] != MEASURED:
            words = f"{title}. Bars: 95 % from the claimed errors, cut where they are long."
            drawn.append(("estimates", estimates_figure(own), words))
    counts: Counter[str] = Counter()
    for kind, drawing, words in drawn:
        if drawing is not None:
            counts[kind] += 1
            yield Figure(f"{kind}-{counts[kind]}", drawing, words)
