"""The sections of a report on estimates: over conditions, compared, from run to run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pilotid.analysis.contrasts import Contrast
from pilotid.analysis.figures import estimates_figure, spread_figure
from pilotid.analysis.results import Results
from pilotid.analysis.rows import Layout, Stratum, by_table, layouts, mean_and_spread
from pilotid.analysis.spread import ConditionSpread
from pilotid.numbers import MINUS, NONE, decimals, number
from pilotid.report.content import Block, Column, Entry, Picture, Section, Table, Text, entries

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Below this a difference is called one.
LEVEL = 0.05
#: Pairs of conditions of which all differences are shown at once.
FEW = 3


def group_words(group: Sequence[tuple[str, str]]) -> str:
    """A group of recordings, or the stratum of a contrast, in words."""
    fields = [value for field, value in group if field != "file"]
    return " ".join(fields) or " ".join(Path(value).stem for _, value in group)


def _picture(figure: Figure, name: str, alt: str, caption: str) -> Picture:
    """A figure for the page, which is a PDF beside it too."""
    return Picture.of(figure, name, alt, caption).with_pdf()


def _title(stratum: Stratum, method: str, model: str) -> str:
    words = [group_words(stratum), f"method `{method}`", f"model `{model}`" if model else ""]
    return ", ".join(word for word in words if word)


def estimates(results: Results) -> Iterator[Section]:
    """Estimates over conditions, in tables and figures; nothing where there are none."""
    found = layouts(results.shown, results.chosen)
    groups = by_table(found, one_model=results.chosen is None)
    blocks: list[Block] = []
    for place, ((stratum, method, model), own) in enumerate(groups.items(), start=1):
        title = _title(stratum, method, model)
        blocks.append(_means(own, title))
        blocks.append(
            _picture(
                estimates_figure(own),
                f"estimates-{place}",
                f"Estimates over conditions, {title}",
                f"Estimates over conditions, {title}. Bars: 95 % from the claimed errors"
                + (", with the variation from run to run" if results.wider else "")
                + "; black: means over subjects. Long bars are cut.",
            )
        )
    if blocks:
        intro = "Means over subjects with the standard deviation between them, or single values."
        yield Section("estimates", "Estimates", [Text(intro), *blocks])


def _means(own: Sequence[Layout], title: str) -> Table:
    conditions = list(dict.fromkeys(c for layout in own for c in layout.conditions))
    heads = [c or "all" for c in conditions]
    columns = [Column("parameter", text=True), Column("unit", text=True), *map(Column, heads)]
    rows = [
        [layout.parameter, layout.unit, *(_mean(layout, c) for c in conditions)] for layout in own
    ]
    models = {c: layout.models[c] for layout in own for c in layout.conditions}
    if len(set(models.values())) > 1:
        rows.insert(0, ["model", "", *(f"`{models[c]}`" for c in conditions)])
    return Table(f"Estimates: {title}", columns, entries(rows))


def _mean(layout: Layout, condition: str) -> str:
    cells = [c for c in layout.cells.get(condition, {}).values() if not c.fault]
    if not cells:
        return NONE if condition not in layout.cells else "no usable fit"
    mean, spread = mean_and_spread(cells)
    if len(cells) > 1:
        return f"{to_error(mean, spread)} ± {to_error(spread, spread)} ({len(cells)})"
    error = cells[0].std_error
    return f"{to_error(mean, error)} ± {to_error(error, error)}"


def to_error(value: float, error: float) -> str:
    """A value with the decimals that its error allows."""
    if not (math.isfinite(error) and error > 0.0):
        return number(value)
    text = f"{value:.{decimals(error, most=4)}f}"
    return text.replace("-", MINUS)


def conditions(results: Results) -> Iterator[Section]:
    """Conditions compared, in pairs and together; nothing where none were."""
    if not results.contrasts:
        return
    groups: dict[str, list[Contrast]] = {}
    for contrast in without_repeats(results.contrasts):
        same = contrast.model_a if contrast.model_a == contrast.model_b else ""
        model = "" if results.chosen is not None else same
        groups.setdefault(_title(contrast.stratum, contrast.method, model), []).append(contrast)
    blocks: list[Block] = [
        Text(
            "Paired differences over subjects, b less a, between conditions or between parameters "
            "of the same fits: mean with the 95 % interval, t-test, p "
            "and p after Holm's correction for the number of pairs or conditions, effect size "
            "(Cohen's d_z after Hedges). Weighted: by claimed errors, with the spread between "
            "subjects apart from the errors of estimation (random effects). `contrasts.csv` has "
            "it all."
        )
    ]
    for title, own in groups.items():
        shown = sorted(own, key=lambda c: (not c.p_holm < LEVEL, c.condition_a, c.condition_b))
        many = len(_conditions_compared(own)) > FEW
        if many:
            clear = [c for c in shown if c.p_holm < LEVEL or c.weighted_p_holm < LEVEL or c.within]
            caption = f"Differences with p < {LEVEL:g} after Holm's correction: {title}"
            blocks.append(_contrast_table(clear, caption))
        blocks.append(_contrast_table(own, f"All differences: {title}", folded=many))
    mixed = [c for c in results.contrasts if c.model_a != c.model_b]
    if mixed:
        blocks.append(
            Text(
                "Where the models of two conditions differ, parameters of the same key are "
                "compared; a gain or lead beside a lag or a motion channel need not mean the "
                "same as one without. `--model` with one name fits the same to all."
            )
        )
    if results.repeated:
        blocks.append(_repeated(results))
    yield Section("conditions", "Conditions compared", blocks)


def contrast_overview(results: Results) -> tuple[list[Contrast], str]:
    """What a terminal shows of contrasts, all of few or the clear ones of many, and its title."""
    distinct = without_repeats(results.contrasts)
    if not _conditions_compared(distinct):
        return distinct, "differences between parameters of the same fits"
    if len(_conditions_compared(distinct)) <= FEW:
        return distinct, "differences between conditions, b less a"
    clear = [c for c in distinct if c.p_holm < LEVEL or c.within]
    return clear, f"differences between conditions with p < {LEVEL:g} after Holm's correction"


def _conditions_compared(own: Sequence[Contrast]) -> set[tuple[str, str]]:
    return {(c.condition_a, c.condition_b) for c in own if not c.within}


def without_repeats(found: Sequence[Contrast]) -> list[Contrast]:
    """Contrasts but those of a disturbance loop that is the target loop, as without motion."""

    def place(contrast: Contrast) -> tuple[object, ...]:
        quantity = contrast.parameter.removeprefix("disturbance_")
        models = contrast.model_a, contrast.model_b
        conditions = contrast.condition_a, contrast.condition_b
        return contrast.stratum, contrast.method, *models, *conditions, quantity

    targets = {
        place(replace(c, parameter=c.parameter.removeprefix("target_"))): c
        for c in found
        if c.parameter.startswith("target_")
    }
    kept = []
    for contrast in found:
        target = targets.get(place(contrast))
        if (
            target is None
            or not contrast.parameter.startswith("disturbance_")
            or not all(
                math.isclose(getattr(contrast, name), getattr(target, name), rel_tol=1e-6)
                for name in ("mean_a", "mean_b")
            )
        ):
            kept.append(contrast)
    return kept


def _contrast_table(own: Sequence[Contrast], caption: str, *, folded: bool = False) -> Table:
    columns = [
        Column("conditions", text=True),
        Column("parameter", text=True),
        Column("unit", text=True),
        Column("n", hint="subjects"),
        Column("difference"),
        Column("95 % interval"),
        Column("t"),
        Column("p"),
        Column("p Holm"),
        Column("d_z"),
        Column("weighted"),
        Column("p weighted"),
        Column("between subjects", hint="spread of the true differences"),
        Column("claimed", hint="typical error of one difference"),
    ]
    rows: list[list[Entry]] = []
    for c in own:
        error = c.std_error if math.isfinite(c.std_error) else c.claimed_error
        mark = "good" if c.p_holm < LEVEL else ""
        rows.append(
            [
                Entry(c.condition_a if c.within else f"{c.condition_a} → {c.condition_b}"),
                Entry(c.parameter),
                Entry(c.unit),
                Entry(str(c.subjects)),
                Entry(to_error(c.difference, error)),
                Entry(f"{to_error(c.lower, error)} .. {to_error(c.upper, error)}"),
                Entry(number(c.t)),
                Entry(chance(c.p)),
                Entry(chance(c.p_holm), mark),
                Entry(number(c.effect_size, 2)),
                Entry(to_error(c.weighted_difference, error)),
                Entry(chance(c.weighted_p)),
                Entry(to_error(c.between_subjects, error)),
                Entry(to_error(c.claimed_error, error)),
            ]
        )
    return Table(caption, columns, rows, heads=2, folded=folded)


def chance(p: float) -> str:
    """A p-value as papers print it."""
    if not math.isfinite(p):
        return NONE
    return "< .001" if p < 0.001 else f"{p:.3f}".lstrip("0")


def _repeated(results: Results) -> Table:
    columns = [
        Column("stratum", text=True),
        Column("method", text=True),
        Column("parameter", text=True),
        Column("conditions", text=True),
        Column("subjects"),
        Column("F"),
        Column("df"),
        Column("p"),
        Column("p corrected", hint="Greenhouse and Geisser"),
        Column("p mixed", hint="likelihood ratio of a mixed model with a random intercept"),
    ]
    rows = [
        [
            group_words(r.stratum) or NONE,
            r.method,
            r.parameter,
            " ".join(r.conditions),
            str(len(r.subjects)),
            number(r.f),
            f"{r.df1:.0f}, {r.df2:.0f}" if math.isfinite(r.df2) else NONE,
            chance(r.p),
            chance(r.p_corrected),
            chance(r.mixed_p),
        ]
        for r in results.repeated
    ]
    caption = "All conditions together: repeated-measures analysis of variance and mixed model"
    return Table(caption, columns, entries(rows), heads=3, folded=True)


def runs(results: Results) -> Iterator[Section]:
    """How runs differ; nothing where they were not fitted one by one."""
    if not results.by_condition:
        return
    groups: dict[str, list[ConditionSpread]] = {}
    for spread in results.by_condition:
        title = _title(spread.stratum, spread.method, "")
        groups.setdefault(title, []).append(spread)
    blocks: list[Block] = [
        Text(
            "A claimed error says what the same pilot would scatter who did the same again. Runs "
            "fitted one by one show what people do: where they differ by more than they claim, "
            "the errors of fits of all runs together are too short for the pilot, and the "
            "estimates above have errors with the variation from run to run instead "
            "(`runs.csv` has both)."
        )
    ]
    for place, (title, own) in enumerate(groups.items(), start=1):
        alt = f"Scatter of runs over claimed errors, {title}"
        blocks.append(
            _picture(
                spread_figure(own),
                f"runs-{place}",
                alt,
                f"{alt}. Bars: 95 % by chi-squared; 1: as claimed.",
            )
        )
    yield Section("runs", "From run to run", blocks)
