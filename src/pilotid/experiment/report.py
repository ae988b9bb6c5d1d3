"""The tables of an experiment, for its page, for papers and the terminal, and the page itself."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pilotid.estimate.quantities import UNDETERMINED, symbol
from pilotid.experiment.cross_validation import ranked
from pilotid.experiment.figures import estimates_figure, responses_figure, variances_figure
from pilotid.experiment.files import CONDITION, SUBJECT, in_order
from pilotid.experiment.fits import remarks_of
from pilotid.experiment.results import LEFT_OUT, MEASURED, POWER, SHARE, Results, planned
from pilotid.report.page import FIGURES, Figure, save_figures, write_page
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
#: By title, the columns of a frame that a column of a table is made of, and what writes them.
Columns = Mapping[str, tuple[str | tuple[str, ...], Callable[..., str] | None]]


def _interval(low: float, high: float, error: float) -> str:
    return f"[{to_error(low, error)}, {to_error(high, error)}]" if math.isfinite(low) else NONE


TESTED: Columns = {
    "method": ("method", None),
    "conditions": ("conditions", None),
    "parameter": ("parameter", None),
    "unit": ("unit", None),
    "n": ("subjects", "{:.0f}".format),
    "difference": (("difference", "std_error"), unsigned),
    "95 % interval": (("lower_holm_95", "upper_holm_95", "std_error"), _interval),
    "t": ("t", "{:.2f}".format),
    "df": ("freedom", "{:.0f}".format),
    "p": ("p", p_value),
    "p Holm": ("p_holm", p_value),
    "d_z": ("effect_size", number),
    "robust": (("robust_difference", "std_error"), to_error),
    "p ranks": ("wilcoxon_p", p_value),
    "notes": ("notes", None),
}
BRIEF = {
    k: v for k, v in TESTED.items() if k not in ("95 % interval", "robust", "p ranks", "notes")
}
EFFECTS: Columns = {
    "method": ("method", None),
    "parameter": ("parameter", None),
    "effect": ("effect", None),
    "n": ("subjects", str),
    "F": ("F", number),
    "df1": ("df1", "{:.0f}".format),
    "df2": ("df2", "{:.0f}".format),
    "p": ("p", p_value),
    "epsilon": ("epsilon", number),
    "p corrected": ("p_corrected", p_value),
    "partial eta²": ("eta_squared", number),
    "notes": ("notes", None),
}


def frame_table(
    frame: DataFrame, caption: str, columns: Columns, fields: Sequence[str] = (), heads: int = 2
) -> Table:
    """A row of text for each row of a frame; p-values that are significant are marked.

    Parameters
    ----------
    frame, caption, columns
        What is shown.
    fields
        Columns of words in front.
    heads
        How many columns behind these say what a row is about.
    """
    every: Columns = {**{name: (name, None) for name in fields}, **columns}
    rows = [
        [
            tuple(row[n] for n in name) if isinstance(name, tuple) else row[name]
            for name, _ in every.values()
        ]
        for row in frame.to_dict("records")
    ]
    forms = {title: form for title, (_, form) in every.items() if form}
    marks = {
        title: ["good" if p < LEVEL else "" for p in frame[columns[title][0]]]
        for title in ("p Holm", "p corrected")
        if title in columns
    }
    return table(rows, caption, [*every], forms, heads=len(fields) + heads, marks=marks)


def contrast_table(results: Results, found: DataFrame, caption: str, columns: Columns) -> Table:
    """A row for each contrast."""
    pairs = found["condition_a"] + (":" + found["condition_b"])
    pairs = pairs.where(found["condition_a"] != found["condition_b"], found["condition_a"])
    return frame_table(found.assign(conditions=pairs), caption, columns, results.strata, 3)


def notable(results: Results) -> tuple[DataFrame, str]:
    """The contrasts that are shown first, all of few pairs or the significant, and a caption."""
    found = results.contrasts
    shown = found[(found["method"] != MEASURED) | found["parameter"].isin(HEADLINES)]
    within = shown["condition_a"] == shown["condition_b"]
    caption = "Differences b less a, between conditions a:b or parameters of the same fits"
    if shown[~within].groupby(["condition_a", "condition_b"]).ngroups > FEW:
        shown = shown[(shown["p_holm"] < LEVEL) | within]
        caption += f", with p < {LEVEL:g} after Holm's correction for the pairs"
    return shown, caption


def effect_table(results: Results, *, brief: bool = False) -> Table:
    """The effects of factors; in brief those on quantities that are shown first."""
    found, columns = results.factors, EFFECTS
    if brief:
        found = found[(found["method"] != MEASURED) | found["parameter"].isin(HEADLINES)]
        columns = {k: v for k, v in EFFECTS.items() if k not in ("p", "epsilon", "notes")}
    caption = "Effects of the factors: repeated-measures analysis of variance"
    return frame_table(found, caption, columns, results.strata, 3)


def means_tables(results: Results) -> Iterator[Table]:
    """Quantities down, conditions across: means over subjects, or single values with their errors.

    Means have the standard deviation between subjects in parentheses.
    """
    for title, own in results.groups():
        place = CONDITION if CONDITION in own else "file"
        conditions = in_order([*own[place]])
        who = own.groupby(place)[SUBJECT if SUBJECT in own else "file"].nunique()
        rows = []
        for (parameter, unit), of in own.groupby(["parameter", "unit"], sort=False):
            wrong = of[of[LEFT_OUT] != ""]
            out = (
                wrong[place]
                + " "
                + (wrong[SUBJECT] if SUBJECT in of else "")
                + " "
                + wrong[LEFT_OUT]
            )
            here = (of[of[place] == c] for c in conditions)
            cells = (_cell(o, int(who[c])) for o, c in zip(here, conditions, strict=True))
            rows.append((parameter, unit, *cells, "; ".join(out)))
        models = own.groupby(place)["model"].first()
        if models.nunique() > 1:
            title += "; models: " + ", ".join(f"{c} `{models[c]}`" for c in conditions)
        heads = [f"{c or 'all'} (n = {who[c]})" for c in conditions]
        titles = ("parameter", "unit", *heads, "not counted")
        yield table(rows, f"Estimates: {title}", titles, dict.fromkeys(heads, str))


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


def model_table(results: Results) -> Table:
    """What recordings say for each model, summed over those of a condition."""
    found = results.models
    kinds = [name for name in (*results.strata, CONDITION) if name in found] or ["file"]
    sums = ["chi_squared", "freedom", "left_out_chi_squared", "aicc"]
    found = found.assign(**{name: found[name].astype(float) for name in sums})
    groups = found.groupby([*kinds, "model"], sort=False)
    own = (
        groups[sums]
        .sum(min_count=1)
        .join(groups[["pilot_parameters", "vaf", "left_out_vaf"]].mean())
    )
    own = own.join(groups["chosen"].first()).reset_index()
    for name in ("left_out_chi_squared", "aicc"):
        own[name] -= own.groupby(kinds)[name].transform("min")
    own["misfit"] = own["chi_squared"] / own["freedom"]
    own = own.sort_values("left_out_chi_squared", kind="stable").sort_values(kinds, kind="stable")
    columns: Columns = {
        "model": ("model", None),
        "chosen": ("chosen", None),
        "parameters": ("pilot_parameters", "{:.0f}".format),
        "misfit": ("misfit", number),
        "left out": ("left_out_chi_squared", number),
        "ΔAICc": ("aicc", number),
        "VAF %": ("vaf", number),
        "VAF left out %": ("left_out_vaf", number),
    }
    columns = {k: v for k, v in columns.items() if own[str(v[0])].notna().any()}
    caption = "Models: chi-squared of lines per degree of freedom, in runs left out above the best"
    return frame_table(own, caption, columns, kinds, 1)


def left_out_table(results: Results) -> Table:
    """Models and methods by the runs that they predict, within each kind of recording."""
    left = results.left_out.assign(recording=results.left_out["file"])
    kinds = [name for name in (*results.strata, CONDITION) if name in left] or ["recording"]
    found = left.groupby(kinds, sort=False).apply(ranked, include_groups=False).reset_index()
    columns: Columns = {
        "model": ("model", None),
        "method": ("method", None),
        "runs": ("runs", str),
        "failed": ("failed", str),
        "VAF %": (("vaf", "vaf_error"), unsigned),
        "likelihood": (("behind", "behind_error"), plus_minus),
        "halves %": ("halves_percent", number),
        "halves / error": ("halves_z", number),
    }
    caption = "Runs predicted by the fit of the others, the likeliest first"
    return frame_table(found, caption, columns, kinds)


def recording_table(results: Results) -> Table:
    """Every recording, all runs together, with what is said of it and of its fits."""
    rows, fits = [], results.fits
    for fit in (fit for fit in fits.fits if fit.run is None):
        look = fits.looks[fit.part]
        for e in fit.content["estimates"]:
            own = remarks_of([*look["remarks"], *e["remarks"]], fits.settings.ignored)
            said = gravest_first(r for r in own if r.code not in OF_STICK)
            front = fit.part.words, fit.content["model"], e["method"], look["recording"]["runs"]
            rows.append(
                (*front, e["vaf"], e["outcome"], "; ".join(f"[{r.code}] {r}" for r in said))
            )
    titles = ("recording", "model", "method", "runs", "VAF %", "outcome", "remarks")
    forms: dict[str, Callable[..., str]] = {"runs": str, "VAF %": number}
    return table(rows, "Every recording, all runs together", titles, forms)


def alarms(results: Results, worst: int = 3) -> Iterator[str]:
    """How many remarks there are, and the worst of them; what a stick does once."""
    fits, ignored = results.fits, results.fits.settings.ignored
    told = [(part.words, look["remarks"]) for part, look in fits.looks.items()]
    for fit in (fit for fit in fits.fits if fit.run is None):
        where = f"{fit.part.words}, {fit.content['model']}"
        told += [(f"{where} by {e['method']}", e["remarks"]) for e in fit.content["estimates"]]
    every = [(place, remark) for place, own in told for remark in remarks_of(own, ignored)]
    first: dict[str, tuple[str, Remark]] = {}
    for place, remark in every:
        first.setdefault(remark.code, (place, remark))
    counts = Counter(remark.code for _, remark in every)
    if graded := counted_grades(r for _, r in every if r.code not in OF_STICK):
        yield f"Warnings: {graded}."
    grave = [c for c, (_, r) in first.items() if r.grade != "note" and c not in OF_STICK]
    grave.sort(key=lambda code: (GRADES.index(first[code][1].grade), -counts[code]))
    for code in (*grave[:worst], *(code for code in OF_STICK if code in first)):
        place, remark = first[code]
        more = f", and {counts[code] - 1} more" if counts[code] > 1 else ""
        yield f"{remark.line(place + more)}."
    if ignored:
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
    out = int((shown[LEFT_OUT] != "").sum())
    if out:
        yield (
            f"{out} of {len(shown)} estimates count in no mean, test or figure (`--keep-all` "
            "counts them); the last column of their table says which and why."
        )
    ends = Counter(e["outcome"] for f in results.fits.fits for e in f.content["estimates"])
    yield f"Fits: {', '.join(f'{count} {outcome}' for outcome, count in ends.items())}."
    yield from (*alarms(results), *results.notes)


def blocks(results: Results, page: Path | None) -> Iterator[str | Table]:
    """What the terminal shows, with the place of the page where there is one."""
    yield from choices(results)
    if len(results.contrasts):
        yield contrast_table(results, *notable(results), BRIEF)
    if len(results.factors):
        yield effect_table(results, brief=True)
    yield from (*alarms(results), *results.notes, *([f"report: {page}"] if page else []))


def choices(results: Results) -> Iterator[str]:
    """Why each model was chosen."""
    settings = results.fits.settings
    for group, choice in results.fits.choices.items():
        if choice.reason and (settings.auto or len(settings.models) > 1):
            yield f"**{' '.join(group)}** {choice.reason}"


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
        columns = {k: v for k, v in TESTED.items() if k not in ("robust", "p ranks", "notes")}
        caption = "Paired differences b less a over subjects; p Holm for the pairs of conditions"
        tables.append(contrast_table(results, results.contrasts, caption, columns))
    if len(results.factors):
        tables.append(effect_table(results))
    head = f"% Made by: {printable(made_by or 'pilotid.analyse')}\n"
    head += "% Needs \\usepackage{booktabs,longtable}.\n"
    return head + "".join(f"% {printable(own.caption)}\n{latex(own, symbol)}\n" for own in tables)


def write_report(path: Path, results: Results, command: str, versions: str) -> None:
    """Write the page, and its figures as SVG and PDF beside it.

    Parameters
    ----------
    path
        The page.
    results
        What was found.
    command, versions
        The command that made it, and versions that the numbers depend on.
    """
    fits, contrasts = results.fits, results.contrasts
    figures = [*_figures(results)]
    save_figures(path.parent / FIGURES, figures)
    main: list[Table] = []
    supplement = [*means_tables(results), model_table(results), recording_table(results)]
    missing: list[str] = []
    if len(contrasts):
        shown, caption = notable(results)
        columns: Columns = {k: v for k, v in TESTED.items() if k != "notes"}
        main.append(contrast_table(results, shown, caption, columns))
        keys = [*results.strata, "condition_a", "condition_b", "parameter", "notes"]
        rows = shown.loc[shown["notes"] != "", keys].itertuples(index=False, name=None)
        missing += [f"{' '.join(dict.fromkeys(row[:-1]))}: {row[-1]}" for row in rows]
        supplement.insert(0, contrast_table(results, contrasts, "All differences", TESTED))
        caption = (
            f"Subjects with whom {100 * POWER:.0f} % of paired tests at 5 % find a difference of "
            f"{100 * SHARE:.0f} %, by the spread of the differences measured here"
        )
        columns = {
            "method": ("method", None),
            "parameter": ("parameter", None),
            "spread %": ("spread", percent),
            "subjects": ("subjects", "{:.0f}".format),
        }
        supplement.insert(0, frame_table(planned(results), caption, columns, results.strata))
    if len(results.factors):
        main.append(effect_table(results, brief=True))
        supplement.insert(0, effect_table(results))
    if fits.varied:
        found = results.sensitivity
        keys = [n for n in (*results.strata, CONDITION, "otherwise", "method") if n in found]
        shifts: Columns = {name: (name, "{:.1f}".format) for name in found if name not in keys}
        caption = "Shifts of estimates in claimed errors, means over subjects, by other ways to fit"
        supplement.insert(0, frame_table(found, caption, shifts, keys, 0))
    if len(results.left_out):
        main.append(left_out_table(results))
    write_page(
        path,
        "experiment.html",
        title="Pilot models of recorded subjects",
        contents=[("summary", "Summary"), ("results", "Results"), ("supplement", "Supplement")],
        parts=[*fits.looks],
        summary=[*summary(results)],
        excluded=[part.words for part in fits.settings.excluded],
        refused=list(fits.refused),
        main=main,
        missing=missing,
        figures=figures,
        choices=[*choices(results)],
        supplement=supplement,
        command=command,
        versions=versions,
    )


def _figures(results: Results) -> Iterator[Figure]:
    """Variances, estimates and group responses of each stratum and method."""
    if not {SUBJECT, CONDITION} <= {*results.estimates}:
        return
    drawn: list[tuple[str, Any, str]] = []
    for title, own in results.groups():
        if own["method"].iloc[0] == MEASURED:
            words = f"What variances are made of, {title}: means over subjects, 95 % intervals."
            drawn.append(("variances", variances_figure(own), words))
        else:
            words = f"{title}. Bars: 95 % from the claimed errors, cut where they are long."
            drawn.append(("estimates", estimates_figure(own), words))
    for stratum, own in results.responses.groupby("stratum", sort=False):
        words = (
            f"{', '.join(filter(None, ['Responses at the forcing lines', stratum]))}: means over "
            "subjects, in which coefficients that are poorly known weigh little, 95 % intervals; "
            "no model of the pilot."
        )
        drawn.append(("responses", responses_figure(own), words))
    counts: Counter[str] = Counter()
    drawn.sort(key=lambda own: own[0] == "estimates")  # the tall ones last, for fewer pages
    for kind, drawing, words in drawn:
        if drawing is not None:
            counts[kind] += 1
            yield Figure(f"{kind}-{counts[kind]}", drawing, words)
