"""The tables of an analysis, for its report, for papers and for the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from pilotid.analysis.analyse import Analysis, group_of
from pilotid.analysis.board import group_words
from pilotid.analysis.contrasts import LEVEL, Contrast
from pilotid.analysis.factors import Effect
from pilotid.analysis.groups import GroupDifference
from pilotid.analysis.learning import Learning
from pilotid.analysis.repeated import Repeated
from pilotid.analysis.results import Results
from pilotid.analysis.rows import (
    MEASURED,
    Chosen,
    Layout,
    Row,
    Stratum,
    by_table,
    in_order,
    layouts,
    mean_and_spread,
)
from pilotid.document import Column, Table, table_latex
from pilotid.limits import ESTIMATE
from pilotid.model_choice import Candidate
from pilotid.naming.symbols import symbol
from pilotid.numbers import NONE, number, p_value, percent, to_error, unsigned
from pilotid.remarks import GRADES, OF_STICK, Remark, counted_grades, gravest_first
from pilotid.types import printable

#: Pairs of conditions of which all differences are shown at once.
FEW = 3


def table_title(stratum: Stratum, method: str, model: str) -> str:
    """What the numbers of a table are of."""
    if method == MEASURED:
        return ", ".join(filter(None, [group_words(stratum), "performance and control activity"]))
    words = [group_words(stratum), f"method `{method}`", f"model `{model}`" if model else ""]
    return ", ".join(word for word in words if word)


# ------------------------------------------------------------------------------- estimates


def means_table(group: Sequence[Layout], title: str, shared: Sequence[str] = ()) -> Table[Layout]:
    """Parameters down, conditions across: means over subjects, or single values.

    Means have the standard deviation between subjects in parentheses, values their standard error.
    An asterisk marks those with a fit that the forcing functions contradict; parameters that
    conditions share are marked.
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
            if len(subjects) == 1:
                return unsigned(cells[0].value, cells[0].std_error) + mark
            mean, deviation = mean_and_spread(cells)
            fewer = f", n = {len(cells)}" if len(cells) < len(subjects) else ""
            return f"{to_error(mean, deviation)} ({to_error(deviation, deviation)}{fewer}){mark}"

        count = f" (n = {len(subjects)})" if len(subjects) > 1 else ""
        return Column(f"{condition or 'all'}{count}", shown, str)

    if len(set(models.values())) > 1:
        title += "; models: " + ", ".join(f"{c} `{models[c]}`" for c in conditions)
    if any(not c.agrees for layout in group for own in layout.cells.values() for c in own.values()):
        title += "; * with fits that the forcing functions contradict"
    columns: list[Column[Layout]] = [
        Column("parameter", lambda layout: layout.parameter, symbol=symbol),
        Column("unit", lambda layout: layout.unit),
        Column("conditions", lambda layout: "shared" if layout.parameter in shared else ""),
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
    groups: dict[str, list[Contrast]] = {}
    for c in without_repeats(results.contrasts):
        same = c.model_a if c.model_a == c.model_b and results.chosen is None else ""
        groups.setdefault(table_title(c.stratum, c.method, same), []).append(c)
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
        found.append(f"Warnings: {counted_grades(remark for _, remark in told)}.")
    codes: dict[str, list[tuple[str, Remark]]] = {}
    for place, remark in told:
        if remark.grade != "note":
            codes.setdefault(remark.code, []).append((place, remark))
    order = sorted(
        codes, key=lambda code: (GRADES.index(codes[code][0][1].grade), -len(codes[code]))
    )
    for code in order[:worst]:
        (place, first), *others = codes[code]
        more = f", and {len(others)} more" if others else ""
        found.append(f"{first.line(place + more)}.")
    for code in dict.fromkeys(remark.code for _, remark in stick):
        own = [(place, remark) for place, remark in stick if remark.code == code]
        found.append(f"{code}, of the stick: {own[0][1]} ({len(own)} fits).")
    if analysis.ignored:
        found.append(f"Left out by --ignore: {', '.join(sorted(analysis.ignored))}.")
    return found


def contrast_overview(results: Results) -> Table[Contrast]:
    """What a terminal shows of contrasts: all of few, or the significant ones of many."""
    shown = without_repeats(results.contrasts)
    shown = [c for c in shown if c.method != MEASURED or is_headline(c)]
    pairs = len(_pairs(shown))
    caption = "differences between conditions, b less a"
    if not pairs:
        caption = "differences between parameters of the same fits"
    elif pairs > FEW:
        shown = [c for c in shown if is_significant(c) or c.within]
        caption = f"differences between conditions with p < {LEVEL:g} after Holm's correction"
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


def repeated_table(found: Sequence[Repeated]) -> Table[Repeated]:
    """All conditions of each quantity together."""
    columns: list[Column[Repeated]] = [
        Column("stratum", lambda r: group_words(r.stratum) or NONE),
        Column("method", lambda r: r.method),
        Column("parameter", lambda r: r.parameter, symbol=symbol),
        Column("conditions", lambda r: " ".join(r.conditions)),
        Column("subjects", lambda r: len(r.subjects), str),
        Column("F", lambda r: r.f, number),
        Column("df", lambda r: f"{r.df1:.0f}, {r.df2:.0f}" if math.isfinite(r.df2) else None, str),
        Column("p", lambda r: r.p, p_value),
        Column("p corrected", lambda r: r.p_corrected, p_value, "Greenhouse and Geisser"),
        Column("partial eta²", lambda r: r.eta_squared, number, "the effect's size"),
        Column("p mixed", lambda r: r.mixed_p, p_value, "mixed model with a random intercept"),
    ]
    caption = "All conditions together: repeated-measures analysis of variance and mixed model"
    return Table(caption, columns, found, heads=3, folded=True)


def factor_table(found: Sequence[Effect]) -> Table[Effect]:
    """The effects of factors on each quantity."""

    def df(e: Effect) -> str | None:
        own = e.variance
        return f"{own.df1:.0f}, {own.df2:.0f}" if math.isfinite(own.df2) else None

    def mark(e: Effect) -> str:
        return "good" if e.variance.p_corrected < LEVEL else ""

    columns: list[Column[Effect]] = [
        Column("stratum", lambda e: group_words(e.stratum) or NONE),
        Column("method", lambda e: e.method),
        Column("parameter", lambda e: e.parameter, symbol=symbol),
        Column("effect", lambda e: e.effect.replace(":", " x ")),
        Column("subjects", lambda e: len(e.subjects), str),
        Column("F", lambda e: e.variance.f, number),
        Column("df", df, str),
        Column("p", lambda e: e.variance.p, p_value),
        Column("epsilon", lambda e: e.variance.epsilon, number, "Greenhouse and Geisser"),
        Column("p corrected", lambda e: e.variance.p_corrected, p_value, "by epsilon", mark),
        Column("partial eta²", lambda e: e.variance.eta_squared, number, "the effect's size"),
        Column("notes", lambda e: "; ".join(e.notes) or NONE),
    ]
    return Table("Effects of the factors: analysis of variance", columns, found, heads=3)


def _clear(g: GroupDifference) -> str:
    return "good" if g.p_holm < LEVEL else ""


def group_table(found: Sequence[GroupDifference]) -> Table[GroupDifference]:
    """Groups compared in each condition."""
    columns: list[Column[GroupDifference]] = [
        Column("condition", lambda g: group_words((*g.stratum, ("condition", g.condition)))),
        Column("method", lambda g: g.method),
        Column("groups", lambda g: f"{g.group_a}:{g.group_b}"),
        Column("parameter", lambda g: g.parameter, symbol=symbol),
        Column("unit", lambda g: g.unit),
        Column("n", lambda g: f"{g.subjects_a}, {g.subjects_b}", str, "subjects"),
        Column("difference", lambda g: (g.difference, g.std_error), to_error),
        Column("t (df)", lambda g: f"{g.t:.2f} ({g.freedom:.1f})" if g.t == g.t else None, str),
        Column("p", lambda g: g.p, p_value),
        Column("p Holm", lambda g: g.p_holm, p_value, "for all comparisons", _clear),
        Column("g", lambda g: (g.effect_size, 2), number, "Hedges'"),
    ]
    ordered = sorted(found, key=lambda g: (g.stratum, g.condition))  # stable
    return Table("Differences between groups", columns, ordered, heads=3)


def learning_table(found: Sequence[Learning]) -> Table[Learning]:
    """Curves over runs."""

    def shown(name: str) -> Callable[[Learning], tuple[float, float]]:
        return lambda c: (getattr(c.curve, name), getattr(c.errors, name))

    columns: list[Column[Learning]] = [
        Column("condition", lambda c: group_words((*c.stratum, ("condition", c.condition)))),
        Column("method", lambda c: c.method),
        Column("parameter", lambda c: c.parameter, symbol=symbol),
        Column("unit", lambda c: c.unit),
        Column("subjects", lambda c: c.subjects, str),
        Column("start", shown("start"), unsigned),
        Column("end", shown("end"), unsigned),
        Column("constant", shown("constant"), unsigned, "runs"),
        Column("change a run", shown("slope"), unsigned, "of a straight line"),
        Column("p", lambda c: c.p, p_value, "of no change"),
        Column("notes", lambda c: "; ".join(c.notes) or NONE),
    ]
    return Table("Learning curves", columns, found, heads=3)


# ------------------------------------------------------------------- models and recordings


class Model(NamedTuple):
    """A model on all recordings of a group, beside the best values of any model there."""

    group: tuple[tuple[str, str], ...]
    name: str
    chosen: bool
    candidates: Sequence[Candidate]
    best: tuple[float, float, float]

    @property
    def criteria(self) -> tuple[float, float, float]:
        """Sums over the recordings: misfit of runs left out, AICc, BIC."""
        own = self.candidates
        left = sum(sum(c.left_out_chi_squared) for c in own)
        return left, sum(c.aicc for c in own), sum(c.bic for c in own)

    def mean(self, name: str) -> float:
        """Mean of a number over the recordings."""
        return float(sum(getattr(c, name) for c in self.candidates) / len(self.candidates))

    @property
    def misfit(self) -> float:
        """Misfit of the lines per degree of freedom."""
        freedom = max(sum(c.freedom for c in self.candidates), 1)
        return sum(c.chi_squared for c in self.candidates) / freedom


def model_table(analysis: Analysis) -> Table[Model]:
    """What recordings say for each model, in groups of recordings."""

    def above_best(place: int) -> Callable[[Model], float | None]:
        def value(m: Model) -> float | None:
            own = m.criteria[place]
            return None if place == 0 and not own else own - m.best[place]

        return value

    columns: list[Column[Model]] = [
        Column("recordings", lambda m: group_words(m.group)),
        Column("model", lambda m: m.name, mark=lambda m: "good" if m.chosen else ""),
        Column("parameters", lambda m: m.candidates[0].pilot_parameters, str, "of the pilot"),
        Column("misfit", lambda m: m.misfit, number, "chi-squared of lines per degree of freedom"),
        Column("left out", above_best(0), number, "of runs left out of the fit, over the best"),
        Column("ΔAICc", above_best(1), number, "of pilot and remnant, over the best"),
        Column("ΔBIC", above_best(2), number, "of pilot and remnant, over the best"),
        Column("VAF %", lambda m: m.mean("vaf"), number, "of the simulated response"),
        Column("VAF left out %", lambda m: m.mean("left_out_vaf"), number, "in runs left out"),
    ]
    caption = (
        "What recordings say for each model, summed over the recordings of a group (VAF: mean); "
        "the chosen one is marked"
    )
    items = [model for group in analysis.choices for model in _models(analysis, group)]
    return Table(caption, columns, items, heads=2, folded=True)


def _models(analysis: Analysis, group: tuple[tuple[str, str], ...]) -> list[Model]:
    """The models that all recordings of a group were fitted with, the best first."""
    parts = [part for part in analysis.parts if group_of(part) == group]
    held = [{c.model: c for c in analysis.candidates(part)} for part in parts]
    chosen, none = analysis.choices[group].model, (0.0, 0.0, 0.0)
    found = [
        Model(group, name, name == chosen, [own[name] for own in held], none)
        for name in held[0]
        if all(name in own for own in held)
    ]
    left, aicc, bic = (min(values) for values in zip(*(m.criteria for m in found), strict=True))
    found = [m._replace(best=(left, aicc, bic)) for m in found]
    return sorted(found, key=lambda m: m.criteria[0] or m.criteria[1])


class Fit(NamedTuple):
    """A fit of all runs of a recording by one method, and what the model's choice found."""

    name: str
    model: str
    runs: int
    estimate: Mapping[str, Any]
    remarks: Sequence[Remark]
    candidate: Candidate | None


def recording_table(analysis: Analysis) -> Table[Fit]:
    """Every recording, all runs together."""

    def change(name: str) -> Callable[[Fit], float | None]:
        return lambda f: getattr(f.candidate, name) if f.candidate else None

    columns: list[Column[Fit]] = [
        Column("recording", lambda f: f.name),
        Column("model", lambda f: f.model),
        Column("method", lambda f: f.estimate["method"]),
        Column("runs", lambda f: f.runs, str),
        Column("VAF %", lambda f: f.estimate["vaf"], number),
        Column("p constant", change("change_p"), p_value, "of a constant pilot"),
        Column("by %", change("change_size"), percent, "how much a gain or lead changes at most"),
        Column("at s", _change_time, number, "when that is seen best"),
        Column("outcome", lambda f: f.estimate["outcome"]),
        Column("remarks", lambda f: "; ".join(f"[{r.code}] {r}" for r in f.remarks) or NONE),
    ]
    items = []
    for fit in analysis.fits:
        if fit.run is not None:
            continue
        look, page, model = analysis.looks[fit.part], fit.content.get("page"), fit.content["model"]
        name = f"[{fit.part.words}]({page})" if page else fit.part.words
        own = next((c for c in analysis.candidates(fit.part) if c.model == model), None)
        for place, e in enumerate(fit.content["estimates"]):
            told = [Remark(*r) for r in (*(look["remarks"] if not place else ()), *e["remarks"])]
            told = [remark for remark in told if remark.code not in OF_STICK]
            runs = int(look["recording"]["runs"])
            items.append(Fit(name, model, runs, e, gravest_first(told), own))
    caption = "Every recording, all runs together; the names lead to pages with figures"
    return Table(caption, columns, items)


def _change_time(fit: Fit) -> float | None:
    own = fit.candidate
    return own.change_time if own and own.change_p < ESTIMATE.changes else None


# ----------------------------------------------------------------------------------- LaTeX


def tables_tex(
    rows: Sequence[Row],
    contrasts: Sequence[Contrast] = (),
    chosen: Chosen | None = None,
    made_by: str = "",
    shared: Sequence[str] = (),
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
    shared
        Parameters that conditions share.
    """
    parts = [
        f"% Made by: {printable(made_by or 'pilotid.analyse')}",
        r"% Needs \usepackage{booktabs}; each tabular may be put into a table of its own.",
    ]
    for title, group in estimate_groups(rows, chosen):
        table = means_table(group, title, shared)
        parts += [
            f"% {printable(table.caption)}: means over subjects, standard deviations in "
            "parentheses; or values ± standard errors",
            table_latex(table),
        ]
    groups: dict[str, list[Contrast]] = {}
    for c in contrasts:
        models = ", ".join(dict.fromkeys((c.model_a, c.model_b)))
        groups.setdefault(table_title(c.stratum, c.method, models), []).append(c)
    for title, some in groups.items():
        parts += [
            f"% Paired differences between conditions, b less a, over subjects, {printable(title)}",
            "% paired t-test, p after Holm's correction, Cohen's d_z with Hedges' correction",
            table_latex(Table("", [*FRONT, *TEST, *_doubts(some)], some, heads=2)),
        ]
    return "\n".join(parts) + "\n"
