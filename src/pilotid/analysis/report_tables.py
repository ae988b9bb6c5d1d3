"""The tables of an analysis, for its report, for papers and for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from pilotid.analysis.analyse import Analysis, Group, group_of, group_words
from pilotid.analysis.contrasts import LEVEL, Contrast
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
from pilotid.support.document import Column, Table, table_latex, table_of
from pilotid.support.format import NONE, number, p_value, percent, plus_minus, to_error, unsigned
from pilotid.support.limits import ESTIMATE
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


def means_table(group: Sequence[Layout], title: str) -> Table[Layout]:
    """Parameters down, conditions across: means over subjects, or single values.

    Means have the standard deviation between subjects in parentheses, values their standard error.
    An asterisk marks those with a fit that the forcing functions contradict, a dagger those
    with a value that is not determined.
    """
    conditions = in_order([c for layout in group for c in layout.conditions])
    models = {c: layout.models[c] for layout in group for c in layout.conditions}

    def column(condition: str) -> Column[Layout]:
        subjects = {s for layout in group for s in layout.cells.get(condition, {})}

        def shown(layout: Layout) -> str:
            cells = [c for c in layout.cells.get(condition, {}).values() if not c.fault]
            if not cells:
                return NONE
            mark = "" if all(c.agrees for c in cells) else "*"
            determined = all(c.determined for c in cells)
            if len(subjects) == 1:
                if not determined:
                    return UNDETERMINED + mark
                return unsigned(cells[0].value, cells[0].std_error) + mark
            mark += "" if determined else "†"
            mean, deviation = mean_and_spread(cells)
            fewer = f", n = {len(cells)}" if len(cells) < len(subjects) else ""
            return f"{to_error(mean, deviation)} ({to_error(deviation, deviation)}{fewer}){mark}"

        count = f" (n = {len(subjects)})" if len(subjects) > 1 else ""
        return Column(f"{condition or 'all'}{count}", shown, str)

    if len(set(models.values())) > 1:
        title += "; models: " + ", ".join(f"{c} `{models[c]}`" for c in conditions)
    every = [c for layout in group for own in layout.cells.values() for c in own.values()]
    if not all(c.agrees for c in every):
        title += "; * with fits that the forcing functions contradict"
    if not all(c.determined for c in every):
        title += "; † with values that are not determined"
    columns: list[Column[Layout]] = [
        Column("parameter", lambda layout: layout.parameter, symbol=symbol),
        Column("unit", lambda layout: layout.unit),
        *map(column, conditions),
    ]
    return Table(f"Estimates: {title}", columns, group)


def estimate_groups(
    rows: Sequence[Row], chosen: Chosen | None
) -> Iterator[tuple[str, list[Layout]]]:
    """Quantities that share a table, with its title."""
    groups = by_table(layouts(rows, chosen), one_model=chosen is None)
    for key, group in groups.items():
        yield table_title(*key), group


# ------------------------------------------------------------------------------- contrasts


def _error(c: Contrast) -> float:
    return c.std_error if math.isfinite(c.std_error) else c.claimed_error


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
    size = plus_minus(c.difference, _error(c))
    p = p_value(c.p_holm)
    p = f"p {p}" if p.startswith("<") else f"p = {p}"
    return f"{where}, {c.parameter} {size}{unit} ({p})"


def _significant(c: Contrast) -> str:
    return "good" if is_significant(c) else ""


def _doubts(shown: Sequence[Contrast]) -> list[Column[Contrast]]:
    """A column for what speaks against contrasts, if anything does."""
    about = "by the lines of the forcing functions"
    return [Column("doubt", lambda c: c.doubt, hint=about)] * any(c.doubt for c in shown)


#: What is compared, the paired test, and the mean weighted by claimed errors.
FRONT: list[Column[Contrast]] = [
    Column("conditions", _compared),
    Column("parameter", lambda c: c.parameter, symbol=symbol),
    Column("unit", lambda c: c.unit),
    Column("n", lambda c: c.subjects, str, "subjects"),
]
TEST: list[Column[Contrast]] = [
    Column("difference", lambda c: (c.difference, _error(c)), to_error),
    Column(
        "95 % interval",
        lambda c: (c.lower_holm, c.upper_holm, _error(c)),
        _ends,
        "holds zero where p Holm is above 0.05",
    ),
    Column("t (df)", lambda c: f"{c.t:.2f} ({c.freedom:.0f})" if math.isfinite(c.t) else None, str),
    Column("p", lambda c: c.p, p_value),
    Column("p Holm", lambda c: c.p_holm, p_value, "for all comparisons", _significant),
    Column("d_z", lambda c: (c.effect_size, 2), number, "Cohen's, with Hedges' correction"),
]
ROBUST: list[Column[Contrast]] = [
    Column("robust", lambda c: (c.robust_difference, _error(c)), to_error, "Hodges and Lehmann"),
    Column("p ranks", lambda c: c.wilcoxon_p, p_value, "Wilcoxon's signed ranks"),
]
WEIGHTED: list[Column[Contrast]] = [
    Column("weighted", lambda c: (c.weighted_difference, _error(c)), to_error),
    Column("p weighted", lambda c: c.weighted_p, p_value),
    Column("between subjects", lambda c: (c.between_subjects, _error(c)), to_error, "true spread"),
    Column("claimed", lambda c: (c.claimed_error, _error(c)), to_error, "error of a difference"),
]


def contrast_tables(results: Results) -> Iterator[Table[Contrast]]:
    """Differences by stratum, method and model: of many comparisons the significant ones first."""

    def title_of(c: Contrast) -> str:
        same = c.model_a == c.model_b and results.chosen is None
        return table_title(c.stratum, c.method, c.model_a if same else "")

    groups = grouped(without_repeats(results.contrasts), title_of)
    columns = [*FRONT, *TEST, *ROBUST, *WEIGHTED, *_doubts(results.contrasts)]
    for title, own in groups.items():
        many = len(_pairs(own)) > FEW
        if many:
            shown = sorted(own, key=lambda c: (not is_significant(c), c.condition_a, c.condition_b))
            clear = [c for c in shown if is_significant(c) or c.weighted_p_holm < LEVEL or c.within]
            caption = f"Differences with p < {LEVEL:g} after Holm's correction: {title}"
            yield Table(caption, columns, clear, heads=2)
        yield Table(f"All differences: {title}", columns, own, heads=2, folded=many)


def alarms(analysis: Analysis, worst: int = 3) -> list[str]:
    """How many remarks there are, and the worst of them; what a stick does once."""
    every = analysis.remarks
    stick = [(place, remark) for place, remark in every if remark.code in OF_STICK]
    told = [(place, remark) for place, remark in every if remark.code not in OF_STICK]
    found = []
    if told:
        found.append(
            f"Warnings: {counted_grades(remark for _, remark in told)}; "
            "the gravest, then the commonest:"
        )
    codes = grouped((pair for pair in told if pair[1].grade != "note"), lambda pair: pair[1].code)
    order = sorted(
        codes, key=lambda code: (GRADES.index(codes[code][0][1].grade), -len(codes[code]))
    )
    for code in order[:worst]:
        (place, first), *others = codes[code]
        more = f", and {len(others)} more fit{'s' * (len(others) > 1)}" if others else ""
        found.append(f"{first.line(place + more)}.")
    for code, own in grouped(stick, lambda pair: pair[1].code).items():
        found.append(f"{code}, of the stick: {own[0][1]} ({len(own)} fits).")
    if analysis.ignored:
        found.append(f"Left out by --ignore: {', '.join(sorted(analysis.ignored))}.")
    return found


def contrast_overview(results: Results) -> Table[Contrast]:
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
    front: list[Column[Contrast]] = [
        Column("", lambda c: " ".join(value for _, value in c.stratum)),
        Column("method", lambda c: c.method),
    ]
    size: Column[Contrast] = Column("difference", lambda c: (c.difference, _error(c)), unsigned)
    marks: list[Column[Contrast]] = []
    if any(c.doubt for c in shown):
        caption += " (* with fits that the forcing functions contradict, # across models)"
        marks = [Column("", lambda c: "#" * c.across + "*" * bool(c.misspecified))]
    pair = Column("pair", _compared)
    return Table(caption, [*front, pair, *FRONT[1:], size, *TEST[2:], *marks], shown, heads=5)


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


def factor_table(found: Sequence[Effect]) -> Table[Effect]:
    """The effects of factors on each quantity."""

    def df(e: Effect) -> str | None:
        return f"{e.df1:.0f}, {e.df2:.0f}" if math.isfinite(e.df2) else None

    def mark(e: Effect) -> str:
        return "good" if e.p_corrected < LEVEL else ""

    columns: list[Column[Effect]] = [
        Column("stratum", lambda e: group_words(e.stratum) or NONE),
        Column("method", lambda e: e.method),
        Column("parameter", lambda e: e.parameter, symbol=symbol),
        Column("effect", lambda e: e.effect.replace(":", " x ")),
        Column("subjects", lambda e: len(e.subjects), str),
        Column("F", lambda e: e.f, number),
        Column("df", df, str),
        Column("p", lambda e: e.p, p_value),
        Column("epsilon", lambda e: e.epsilon, number, "Greenhouse and Geisser"),
        Column("p corrected", lambda e: e.p_corrected, p_value, "by epsilon", mark),
        Column("partial eta²", lambda e: e.eta_squared, number, "the effect's size"),
        Column("notes", lambda e: "; ".join(e.notes) or NONE),
    ]
    return Table("Effects of the factors: analysis of variance", columns, found, heads=3)


# ------------------------------------------------------------------- models and recordings


def model_table(analysis: Analysis) -> Table[Any]:
    """What recordings say for each model, in groups of recordings."""
    heads = [
        *(("recordings",), ("model", None, "", lambda row: "good" if row[-1] else "")),
        ("parameters", str, "of the pilot"),
        ("misfit", number, "chi-squared of lines per degree of freedom"),
        ("left out", number, "of runs left out of the fit, over the best"),
        ("ΔAICc", number, "of pilot and remnant, over the best"),
        ("ΔBIC", number, "of pilot and remnant, over the best"),
        ("VAF %", number, "of the simulated response"),
        ("VAF left out %", number, "in runs left out"),
    ]
    caption = (
        "What recordings say for each model, summed over the recordings of a group (VAF: mean); "
        "the chosen one is marked"
    )
    rows = [row for group in analysis.choices for row in _model_rows(analysis, group)]
    return table_of(caption, heads, rows, 2, folded=True)


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


def recording_table(analysis: Analysis) -> Table[Any]:
    """Every recording, all runs together."""
    heads = [
        *(("recording",), ("model",), ("method",), ("runs", str), ("VAF %", number)),
        ("p constant", p_value, "of a constant pilot"),
        ("by %", percent, "how much a gain or lead changes at most"),
        ("at s", number, "when that is seen best"),
        *(("outcome",), ("remarks",)),
    ]
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
    return table_of("Every recording, all runs together", heads, rows)


def left_out_table(left: Sequence[LeftOut]) -> Table[Any]:
    """Models and methods by the runs that they predict, within each kind of recording."""
    heads = [
        *(("recordings",), ("model",), ("method",)),
        ("runs", str, "left out of a fit"),
        ("failed", str, "fits of the others that do not count"),
        ("VAF %", unsigned, "of runs left out"),
        ("likelihood", plus_minus, "of a run left out, less the best; nats"),
    ]
    rows = [
        (group_words(group), s.model, s.method, s.runs, s.failed, s.vaf, s.behind)
        for group, own in grouped(left, lambda each: group_of(each.part)).items()
        for s in rank_methods(own)
    ]
    caption = "Runs predicted by the fit of the others, the likeliest first"
    return table_of(caption, heads, rows, 2)


# ----------------------------------------------------------------------------------- LaTeX


def tables_tex(
    rows: Sequence[Row],
    contrasts: Sequence[Contrast] = (),
    chosen: Chosen | None = None,
    made_by: str = "",
) -> str:
    r"""Estimates and contrasts as booktabs tabulars without captions, for ``\input`` in a table.

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
        r"% Needs \usepackage{booktabs}; each tabular may be put into a table of its own.",
    ]
    for title, group in estimate_groups(rows, chosen):
        table = means_table(group, title)
        parts += [
            f"% {printable(table.caption)}: means over subjects, standard deviations in "
            "parentheses; or values ± standard errors",
            table_latex(table),
        ]

    def title_of(c: Contrast) -> str:
        return table_title(c.stratum, c.method, ", ".join(dict.fromkeys((c.model_a, c.model_b))))

    groups = grouped(contrasts, title_of)
    for title, some in groups.items():
        parts += [
            f"% Paired differences between conditions, b less a, over subjects, {printable(title)}",
            "% paired t-test, p after Holm's correction, Cohen's d_z with Hedges' correction",
            table_latex(Table("", [*FRONT, *TEST, *_doubts(some)], some, heads=2)),
        ]
    return "\n".join(parts) + "\n"
