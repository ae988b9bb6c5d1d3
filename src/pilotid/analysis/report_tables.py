"""The tables of an analysis, for its report, for papers and for the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from pilotid.analysis.analyse import Analysis, Group, group_of, group_words
from pilotid.analysis.contrasts import Contrast
from pilotid.analysis.cross_validation import LeftOut, rank_methods
from pilotid.analysis.factors import Effect
from pilotid.analysis.results import Results
from pilotid.analysis.rows import (
    MEASURED,
    Chosen,
    Layout,
    Row,
    Stratum,
    by_table,
    grouped,
    in_order,
    layouts,
    mean_and_spread,
)
from pilotid.estimates.quantities import UNDETERMINED, symbol
from pilotid.support.format import (
    NONE,
    Columns,
    Table,
    latex,
    number,
    p_value,
    percent,
    plus_minus,
    table,
    table_of,
    to_error,
    unsigned,
)
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import LEVEL
from pilotid.support.remarks import GRADES, OF_STICK, Remark, counted_grades, gravest_first
from pilotid.support.types import printable

#: Pairs of conditions of which all differences are shown at once.
FEW = 3


def table_title(stratum: Stratum, method: str, model: str) -> str:
    """What the numbers of a table are of."""
    if method == MEASURED:
        return ", ".join(filter(None, [group_words(stratum), "performance and control activity"]))
    words = [group_words(stratum), f"method `{method}`", f"model `{model}`" if model else ""]
    return ", ".join(word for word in words if word)


# ------------------------------------------------------------------------------- estimates


def means_table(group: Sequence[Layout], title: str) -> Table:
    """Parameters down, conditions across: means over subjects, or single values.

    Means have the standard deviation between subjects in parentheses, values their standard error.
    An asterisk marks those with a fit that the forcing functions contradict, a dagger those
    with a value that is not determined.
    """
    conditions = in_order([c for layout in group for c in layout.conditions])
    models = {c: layout.models[c] for layout in group for c in layout.conditions}
    subjects = {
        c: len({s for layout in group for s in layout.cells.get(c, {})}) for c in conditions
    }

    def shown(layout: Layout, condition: str) -> str:
        cells = [c for c in layout.cells.get(condition, {}).values() if not c.fault]
        if not cells:
            return NONE
        mark = "" if all(c.agrees for c in cells) else "*"
        determined = all(c.determined for c in cells)
        if subjects[condition] == 1:
            if not determined:
                return UNDETERMINED + mark
            return unsigned(cells[0].value, cells[0].std_error) + mark
        mark += "" if determined else "†"
        mean, deviation = mean_and_spread(cells)
        fewer = f", n = {len(cells)}" if len(cells) < subjects[condition] else ""
        return f"{to_error(mean, deviation)} ({to_error(deviation, deviation)}{fewer}){mark}"

    if len(set(models.values())) > 1:
        title += "; models: " + ", ".join(f"{c} `{models[c]}`" for c in conditions)
    every = [c for layout in group for own in layout.cells.values() for c in own.values()]
    if not all(c.agrees for c in every):
        title += "; * with fits that the forcing functions contradict"
    if not all(c.determined for c in every):
        title += "; † with values that are not determined"
    heads = [
        f"{c or 'all'} (n = {subjects[c]})" if subjects[c] > 1 else c or "all" for c in conditions
    ]
    rows = [
        (layout.parameter, layout.unit, *(shown(layout, c) for c in conditions)) for layout in group
    ]
    titles = ("parameter", "unit", *heads)
    return table(rows, f"Estimates: {title}", titles, dict.fromkeys(heads, str))


def estimate_groups(
    rows: Sequence[Row], chosen: Chosen | None
) -> Iterator[tuple[str, list[Layout]]]:
    """Quantities that share a table, with its title."""
    groups = by_table(layouts(rows, chosen), one_model=chosen is None)
    for key, group in groups.items():
        yield table_title(*key), group


# ------------------------------------------------------------------------------- contrasts


def _ends(low: float, high: float, error: float) -> str:
    return f"[{to_error(low, error)}, {to_error(high, error)}]" if math.isfinite(low) else NONE


def _compared(c: Contrast) -> str:
    return c.condition_a if c.within else f"{c.condition_a}:{c.condition_b}"


def is_significant(c: Contrast) -> bool:
    """Whether a contrast counts as a finding: one across models does not."""
    return c.p_holm < LEVEL and not c.across


def difference_words(c: Contrast) -> str:
    """A difference in a sentence: where, of what, by how much, which way, how certain."""
    where = " ".join((*(value for _, value in c.stratum), _compared(c), c.method))
    unit = f" {c.unit}" if c.unit else ""
    size = plus_minus(c.difference, c.std_error)
    p = p_value(c.p_holm)
    p = f"p {p}" if p.startswith("<") else f"p = {p}"
    return f"{where}, {c.parameter} {size}{unit} ({p})"


#: Columns of contrasts.
COLUMNS: Columns = {
    "": (lambda c: " ".join(value for _, value in c.stratum), None, ""),
    "method": (lambda c: c.method, None, ""),
    "conditions": (_compared, None, ""),
    "parameter": (lambda c: c.parameter, None, ""),
    "unit": (lambda c: c.unit, None, ""),
    "n": (lambda c: c.subjects, str, "subjects"),
    "difference": (lambda c: (c.difference, c.std_error), to_error, ""),
    "difference ± error": (lambda c: (c.difference, c.std_error), unsigned, ""),
    "95 % interval": (
        lambda c: (c.lower_holm, c.upper_holm, c.std_error),
        _ends,
        "holds zero where p Holm is above 0.05",
    ),
    "t (df)": (
        lambda c: f"{c.t:.2f} ({c.freedom:.0f})" if math.isfinite(c.t) else None,
        str,
        "",
    ),
    "p": (lambda c: c.p, p_value, ""),
    "p Holm": (lambda c: c.p_holm, p_value, "for all comparisons"),
    "d_z": (lambda c: (c.effect_size, 2), number, "Cohen's, with Hedges' correction"),
    "robust": (lambda c: (c.robust_difference, c.std_error), to_error, "Hodges and Lehmann"),
    "p ranks": (lambda c: c.wilcoxon_p, p_value, "Wilcoxon's signed ranks"),
    "doubt": (lambda c: c.doubt, None, "by the lines of the forcing functions"),
    "mark": (lambda c: "#" * c.across + "*" * bool(c.misspecified), None, ""),
}
FRONT = ("conditions", "parameter", "unit", "n")
TEST = ("t (df)", "p", "p Holm", "d_z")
MORE = ("robust", "p ranks")


def _contrast_table(
    caption: str, found: Sequence[Contrast], titles: Sequence[str], heads: int = 2
) -> Table:
    """A row for each contrast; what speaks against them stands last."""
    titles = [*titles, *["doubt"] * ("mark" not in titles and any(c.doubt for c in found))]
    columns = {title: COLUMNS[title] for title in titles}
    marks = {"p Holm": ["good" if is_significant(c) else "" for c in found]}
    return table_of(found, caption, columns, heads=heads, marks=marks)


def contrast_tables(results: Results) -> Iterator[tuple[Table, bool]]:
    """Differences by stratum, method and model, and whether a page folds the table.

    Of many comparisons the significant ones come first.
    """

    def title_of(c: Contrast) -> str:
        same = c.model_a == c.model_b and results.chosen is None
        return table_title(c.stratum, c.method, c.model_a if same else "")

    groups = grouped(without_repeats(results.contrasts), title_of)
    titles = (*FRONT, "difference", "95 % interval", *TEST, *MORE)
    for title, own in groups.items():
        many = len(_pairs(own)) > FEW
        if many:
            shown = sorted(own, key=lambda c: (not is_significant(c), c.condition_a, c.condition_b))
            clear = [c for c in shown if is_significant(c) or c.within]
            caption = f"Differences with p < {LEVEL:g} after Holm's correction: {title}"
            yield _contrast_table(caption, clear, titles), False
        yield _contrast_table(f"All differences: {title}", own, titles), many


def alarms(analysis: Analysis, worst: int = 3) -> list[str]:
    """How many remarks there are, and the worst of them; what a stick does once."""
    every = analysis.remarks
    stick = [(place, remark) for place, remark in every if remark.code in OF_STICK]
    told = [(place, remark) for place, remark in every if remark.code not in OF_STICK]
    found = []
    if told:
        grave = any(remark.grade != "note" for _, remark in told)
        order = "; the gravest, then the commonest:" if grave else "."
        found.append(f"Warnings: {counted_grades(remark for _, remark in told)}{order}")
    codes = grouped((pair for pair in told if pair[1].grade != "note"), lambda pair: pair[1].code)
    for code in sorted(
        codes, key=lambda code: (GRADES.index(codes[code][0][1].grade), -len(codes[code]))
    )[:worst]:
        (place, first), *others = codes[code]
        more = f", and {len(others)} more fit{'s' * (len(others) > 1)}" if others else ""
        found.append(f"{first.line(place + more)}.")
    for code, own in grouped(stick, lambda pair: pair[1].code).items():
        found.append(f"{code}, of the stick: {own[0][1]} ({len(own)} fits).")
    if analysis.ignored:
        found.append(f"Left out by --ignore: {', '.join(sorted(analysis.ignored))}.")
    return found


def contrast_overview(results: Results) -> Table:
    """What a terminal shows of contrasts: all of few, or the significant ones of many."""
    shown = without_repeats(results.contrasts)
    shown = [c for c in shown if c.method != MEASURED or is_headline(c)]
    pairs = len(_pairs(shown))
    caption = "differences between conditions a:b, b minus a"
    if not pairs:
        caption = "differences between parameters of the same fits"
    elif pairs > FEW:
        shown = [c for c in shown if is_significant(c) or c.within]
        caption = "differences between conditions a:b, b minus a, with p < "
        caption += f"{LEVEL:g} after Holm's correction for the pairs"
    titles = ["", "method", *FRONT, "difference ± error", *TEST]
    if any(c.doubt for c in shown):
        caption += " (* with fits that the forcing functions contradict, # across models)"
        titles.append("mark")
    return _contrast_table(caption, shown, titles, heads=5)


def _pairs(own: Sequence[Contrast]) -> set[tuple[str, str]]:
    return {(c.condition_a, c.condition_b) for c in own if not c.within}


def is_headline(c: Contrast) -> bool:
    """Whether it is of a variance as a whole, or of the share of remnant."""
    return c.parameter in ("var_e", "var_u", "remnant_share_u")


def counted(found: Sequence[Contrast]) -> list[Contrast]:
    """Contrasts that count in a summary, each once: an rms says what a variance does."""
    once = [c for c in found if not c.parameter.startswith("rms_")]
    return [c for c in without_repeats(once) if not c.across]


def without_repeats(found: Sequence[Contrast]) -> list[Contrast]:
    """Contrasts but those of a disturbance loop that is the target loop, as without motion."""

    def place(c: Contrast) -> tuple[object, ...]:
        models, conditions = (c.model_a, c.model_b), (c.condition_a, c.condition_b)
        return c.stratum, c.method, models, conditions, c.parameter

    targets = {place(c): c for c in found if c.parameter.startswith("target_")}

    def repeats(c: Contrast) -> bool:
        name = c.parameter.removeprefix("disturbance_")
        target = targets.get(place(replace(c, parameter=f"target_{name}")))
        return (
            target is not None
            and name != c.parameter
            and math.isclose(c.mean_a, target.mean_a, rel_tol=1e-6)
            and math.isclose(c.mean_b, target.mean_b, rel_tol=1e-6)
        )

    return [c for c in found if not repeats(c)]


def factor_table(found: Sequence[Effect]) -> Table:
    """The effects of factors on each quantity."""
    titles = (
        *("stratum", "method", "parameter", "effect", "subjects", "F", "df", "p", "epsilon"),
        *("p corrected", "partial eta²", "notes"),
    )
    rows = [
        (
            *(group_words(e.stratum) or NONE, e.method, e.parameter, e.effect.replace(":", " x ")),
            *(len(e.subjects), e.f),
            f"{e.df1:.0f}, {e.df2:.0f}" if math.isfinite(e.df2) else None,
            *(e.p, e.epsilon, e.p_corrected, e.eta_squared, "; ".join(e.notes) or NONE),
        )
        for e in found
    ]
    forms: dict[str, Callable[..., str]] = {
        **dict.fromkeys(("subjects", "df"), str),
        **dict.fromkeys(("F", "epsilon", "partial eta²"), number),
        **dict.fromkeys(("p", "p corrected"), p_value),
    }
    hints = {
        "epsilon": "Greenhouse and Geisser",
        "p corrected": "by epsilon",
        "partial eta²": "the effect's size",
    }
    marks = {"p corrected": ["good" if e.p_corrected < LEVEL else "" for e in found]}
    caption = "Effects of the factors: analysis of variance"
    return table(rows, caption, titles, forms, heads=3, hints=hints, marks=marks)


# ------------------------------------------------------------------- models and recordings


def model_table(analysis: Analysis) -> Table:
    """What recordings say for each model, in groups of recordings."""
    hints = {
        "parameters": "of the pilot",
        "misfit": "chi-squared of lines per degree of freedom",
        "left out": "of runs left out of the fit, over the best",
        "ΔAICc": "of pilot and remnant, over the best",
        "ΔBIC": "of pilot and remnant, over the best",
        "VAF %": "of the simulated response",
        "VAF left out %": "in runs left out",
    }
    caption = (
        "What recordings say for each model, summed over the recordings of a group (VAF: mean); "
        "the chosen one is marked"
    )
    rows = [row for group in analysis.choices for row in _model_rows(analysis, group)]
    forms: dict[str, Callable[..., str]] = {**dict.fromkeys(hints, number), "parameters": str}
    marks = {"model": ["good" if row[-1] else "" for row in rows]}
    titles = ("recordings", "model", *hints)
    shown = [row[:-1] for row in rows]
    return table(shown, caption, titles, forms, heads=2, hints=hints, marks=marks)


def _model_rows(analysis: Analysis, group: Group) -> Iterator[tuple[object, ...]]:
    """The models that all recordings of a group were fitted with, the best first."""
    parts = [part for part in analysis.parts if group_of(part) == group]
    held = [{c.model: c for c in analysis.candidates(part)} for part in parts]
    found = []
    for name in (name for name in held[0] if all(name in own for own in held)):
        own = [candidates[name] for candidates in held]
        left_out = sum(sum(c.left_out_chi_squared) for c in own)
        found.append(((left_out, sum(c.aicc for c in own), sum(c.bic for c in own)), name, own))
    best = [min(values) for values in zip(*(sums for sums, *_ in found), strict=True)]
    for sums, name, own in sorted(found, key=lambda each: each[0][0] or each[0][1]):
        left_out, aicc, bic = (a - b for a, b in zip(sums, best, strict=True))
        freedom = max(sum(c.freedom for c in own), 1)
        yield (
            *(group_words(group), name, own[0].pilot_parameters),
            sum(c.chi_squared for c in own) / freedom,
            *(left_out if sums[0] else None, aicc, bic),
            sum(c.vaf for c in own) / len(own),
            sum(c.left_out_vaf for c in own) / len(own),
            name == analysis.choices[group].model,
        )


def recording_table(analysis: Analysis) -> Table:
    """Every recording, all runs together."""
    forms: dict[str, Callable[..., str]] = {
        "runs": str,
        "VAF %": number,
        "p constant": p_value,
        "by %": percent,
        "at s": number,
    }
    hints = {
        "p constant": "of a constant pilot",
        "by %": "how much a gain or lead changes at most",
        "at s": "when that is seen best",
    }
    rows = []
    for fit in (fit for fit in analysis.fits if fit.run is None):
        look, model = analysis.looks[fit.part], fit.content["model"]
        c = next((c for c in analysis.candidates(fit.part) if c.model == model), None)
        when = c.change_time if c and c.change_p < ESTIMATE.changes else None
        change = (c.change_p, c.change_size, when) if c else (None, None, None)
        for place, e in enumerate(fit.content["estimates"]):
            told = [Remark(*r) for r in (*(look["remarks"] if not place else ()), *e["remarks"])]
            own = gravest_first([remark for remark in told if remark.code not in OF_STICK])
            front = fit.part.words, model, e["method"], int(look["recording"]["runs"]), e["vaf"]
            remarks = "; ".join(f"[{remark.code}] {remark}" for remark in own)
            rows.append((*front, *change, e["outcome"], remarks or NONE))
    titles = ("recording", "model", "method", *forms, "outcome", "remarks")
    return table(rows, "Every recording, all runs together", titles, forms, hints=hints)


def left_out_table(left: Sequence[LeftOut]) -> Table:
    """Models and methods by the runs that they predict, within each kind of recording."""
    forms: dict[str, Callable[..., str]] = {
        "runs": str,
        "failed": str,
        "VAF %": unsigned,
        "likelihood": plus_minus,
    }
    hints = {
        "runs": "left out of a fit",
        "failed": "fits of the others that do not count",
        "VAF %": "of runs left out",
        "likelihood": "of a run left out, less the best; nats",
    }
    rows = [
        (group_words(group), s.model, s.method, s.runs, s.failed, s.vaf, s.behind)
        for group, own in grouped(left, lambda each: group_of(each.part)).items()
        for s in rank_methods(own)
    ]
    caption = "Runs predicted by the fit of the others, the likeliest first"
    titles = ("recordings", "model", "method", *forms)
    return table(rows, caption, titles, forms, heads=2, hints=hints)


# ----------------------------------------------------------------------------------- LaTeX


def tables_tex(
    rows: Sequence[Row],
    contrasts: Sequence[Contrast] = (),
    chosen: Chosen | None = None,
    made_by: str = "",
) -> str:
    r"""Estimates and contrasts as booktabs longtables without captions, for ``\input``.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv; fits of all runs together are shown.
    contrasts
        Contrasts to show.
    chosen
        The model of each stratum and condition, as for `contrasts`.
    made_by
        The command that made them, for the comment at the head.
    """
    parts = [
        f"% Made by: {printable(made_by or 'pilotid.analyse')}",
        r"% Needs \usepackage{booktabs,longtable}.",
    ]
    for title, group in estimate_groups(rows, chosen):
        means = means_table(group, title)
        parts += [
            f"% {printable(means.caption)}: means over subjects, standard deviations in "
            "parentheses; or values ± standard errors",
            latex(means, symbol),
        ]

    def title_of(c: Contrast) -> str:
        return table_title(c.stratum, c.method, ", ".join(dict.fromkeys((c.model_a, c.model_b))))

    groups = grouped(contrasts, title_of)
    for title, some in groups.items():
        parts += [
            f"% Paired differences between conditions, b less a, over subjects, {printable(title)}",
            "% paired t-test, p after Holm's correction, Cohen's d_z with Hedges' correction",
            latex(
                _contrast_table("", some, (*FRONT, "difference", "95 % interval", *TEST)), symbol
            ),
        ]
    return "\n".join(parts) + "\n"
