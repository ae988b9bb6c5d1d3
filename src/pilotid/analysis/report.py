"""The report of an analysis: summary, models, estimates, contrasts, runs, recordings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pilotid.analysis.analyse import Analysis, group_of
from pilotid.analysis.cells import Layout, Stratum, layouts
from pilotid.analysis.contrasts import Contrast
from pilotid.analysis.figures import estimates_figure, spread_figure
from pilotid.analysis.results import Results
from pilotid.analysis.rows import SUBJECT
from pilotid.analysis.spread import ConditionSpread, spread_sentence
from pilotid.disk import make_folder, write_file
from pilotid.numbers import MINUS, NONE, decimals, number
from pilotid.report.content import (
    Block,
    Bullets,
    Column,
    Command,
    Entry,
    Picture,
    Section,
    Table,
    Text,
    entries,
    web_page,
)

TITLE = "Pilot models of recorded subjects"

#: Below this a difference is called one.
LEVEL = 0.05
#: Pairs of conditions of which all differences are shown at once.
FEW = 3


def write_report(folder: Path, results: Results, command: str, about: Mapping[str, str]) -> Path:
    """Write report.html and its figures as SVG.

    Parameters
    ----------
    folder
        Where to write.
    results
        What was found.
    command
        The command that made it.
    about
        Versions that the numbers depend on.
    """
    sections = [
        _summary(results),
        _models(results),
        *_estimates(results),
        *_contrasts(results),
        *_runs(results),
        _recordings(results.analysis),
        _origin(results, command, about),
    ]
    pictures = folder / "figures"
    make_folder(pictures)
    for block in (block for section in sections for block in section.blocks):
        if isinstance(block, Picture):
            write_file(pictures / f"{block.name}.svg", block.svg.encode())
    path = folder / "report.html"
    write_file(path, web_page(TITLE, sections).encode("utf-8", "replace"))
    return path


def _summary(results: Results) -> Section:
    analysis = results.analysis
    subjects = {dict(part.fields).get(SUBJECT) for part in analysis.parts} - {None}
    runs = sum(int(look["recording"]["runs"]) for look in analysis.looks)
    of = f" of {len(subjects)} subjects" if subjects else ""
    told = [f"{len(analysis.parts)} recordings{of}, {runs} runs."]
    items: list[str] = []
    if results.chosen is not None:
        chosen: dict[str, list[str]] = {}
        for group, choice in analysis.choices.items():
            chosen.setdefault(choice.model, []).append(_group_words(group) or "all")
        items += [f"Model `{model}`: {'; '.join(where)}." for model, where in chosen.items()]
    clear = [c for c in results.contrasts if c.p_holm < LEVEL]
    if results.contrasts:
        items.append(
            f"{len(clear)} of {len(results.contrasts)} differences between conditions have p < "
            f"{LEVEL:g} after Holm's correction"
            + (": see [conditions](#conditions)." if clear else ".")
        )
    told_of = [s for s in map(spread_sentence, _by_condition(results)) if s]
    items += [f"{s[0].upper()}{s[1:]}." for s in told_of]
    failed = [
        f"{fit.part.words}: `{e['method']}` {e['verdict'].partition(': ')[2]}"
        for fit in analysis.fits
        if fit.run is None
        for e in fit.content["estimates"]
        if e["outcome"] != "converged"
    ]
    if failed:
        items.append(f"Not converged, or at a bound: {'; '.join(failed)}.")
    remarked = sum(bool(look["remarks"]) for look in analysis.looks)
    if remarked:
        items.append(f"{remarked} recordings have remarks: see [recordings](#recordings).")
    items += results.notes
    blocks: list[Block] = [Text(" ".join(told)), Bullets(items)]
    if analysis.refused:
        blocks += [Text("**Left out:**"), Bullets(list(analysis.refused))]
    return Section("summary", "Summary", blocks)


def _group_words(group: Sequence[tuple[str, str]]) -> str:
    """A group of recordings, or the stratum of a contrast, in words."""
    fields = [value for field, value in group if field != "file"]
    return " ".join(fields) or " ".join(Path(value).stem for _, value in group)


def _models(results: Results) -> Section:
    analysis = results.analysis
    items = [
        f"**{_group_words(group)}** {choice.reason}"
        for group, choice in analysis.choices.items()
        if choice.reason
    ]
    columns = [
        Column("recordings", text=True),
        Column("model", text=True),
        Column("parameters", hint="of the pilot"),
        Column("misfit", hint="chi-squared of the forcing functions' lines per degree of freedom"),
        Column("left out", hint="the same of runs left out of the fit, summed, over the best"),
        Column("ΔAICc", hint="of pilot and remnant, over the best"),
        Column("ΔBIC", hint="of pilot and remnant, over the best"),
        Column("VAF %", hint="variance accounted for by the simulated response"),
        Column("VAF left out %", hint="the same in runs left out of the fit"),
    ]
    rows = [row for group in analysis.choices for row in _model_rows(analysis, group)]
    caption = (
        "What recordings say for each model, summed over the recordings of a group (VAF: mean); "
        "the chosen one is marked"
    )
    reading = (
        "What judges is the control at the lines of the forcing functions against what the model "
        "in its loop makes of them, in runs left out of the fit. Information criteria of the whole "
        "control are shown beside it, but a channel on the output can win there as the inverse of "
        "the controlled element, with a simulated response that explains nothing (VAF)."
    )
    return Section(
        "models",
        "Which model",
        [Bullets(items), Table(caption, columns, rows, heads=2), Text(reading)],
    )


def _model_rows(analysis: Analysis, group: Sequence[tuple[str, str]]) -> Iterator[list[Entry]]:
    parts = [part for part in analysis.parts if group_of(part) == tuple(group)]
    held = [{c.model: c for c in analysis.candidates(part)} for part in parts]
    names = [name for name in held[0] if all(name in own for own in held)]
    left = {n: sum(sum(own[n].left_out_misfit) for own in held) for n in names}
    aicc = {n: sum(own[n].aicc for own in held) for n in names}
    bic = {n: sum(own[n].bic for own in held) for n in names}
    for name in sorted(names, key=lambda n: left[n] or aicc[n]):
        own = [candidates[name] for candidates in held]
        mark = "good" if name == analysis.choices[tuple(group)].model else ""
        yield [
            Entry(_group_words(group)),
            Entry(name, mark),
            Entry(str(own[0].pilot)),
            Entry(number(sum(c.misfit for c in own) / max(sum(c.freedom for c in own), 1))),
            Entry(number(left[name] - min(left.values())) if left[name] else NONE),
            Entry(number(aicc[name] - min(aicc.values()))),
            Entry(number(bic[name] - min(bic.values()))),
            Entry(number(sum(c.vaf for c in own) / len(own))),
            Entry(number(sum(c.left_out_vaf for c in own) / len(own))),
        ]


def _groups(found: Sequence[Layout]) -> dict[tuple[Stratum, str, str], list[Layout]]:
    """Quantities by stratum, method and, where every model has its own, model."""
    groups: dict[tuple[Stratum, str, str], list[Layout]] = {}
    for layout in found:
        models = set(layout.models.values())
        model = next(iter(models)) if len(models) == 1 else ""
        groups.setdefault((layout.stratum, layout.method, model), []).append(layout)
    return groups


def _title(stratum: Stratum, method: str, model: str) -> str:
    words = [_group_words(stratum), f"method `{method}`", f"model `{model}`" if model else ""]
    return ", ".join(word for word in words if word)


def _estimates(results: Results) -> Iterator[Section]:
    found = layouts(results.shown, results.chosen)
    groups = _merged(_groups(found)) if results.chosen is not None else _groups(found)
    blocks: list[Block] = []
    for place, ((stratum, method, model), own) in enumerate(groups.items(), start=1):
        title = _title(stratum, method, model)
        blocks.append(_means(own, title))
        blocks.append(
            Picture.of(
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


def _merged(
    groups: Mapping[tuple[Stratum, str, str], list[Layout]],
) -> dict[tuple[Stratum, str, str], list[Layout]]:
    """One group for each stratum and method: every condition has one model there."""
    merged: dict[tuple[Stratum, str, str], list[Layout]] = {}
    for (stratum, method, _), own in groups.items():
        merged.setdefault((stratum, method, ""), []).extend(own)
    return merged


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
    values = [cell.value for cell in cells]
    mean = sum(values) / len(values)
    if len(values) > 1:
        spread = math.sqrt(sum((v - mean) ** 2 for v in values) / (len(values) - 1))
        return f"{to_error(mean, spread)} ± {to_error(spread, spread)} ({len(values)})"
    error = cells[0].std_error
    return f"{to_error(mean, error)} ± {to_error(error, error)}"


def to_error(value: float, error: float) -> str:
    """A value with the decimals that its error allows."""
    if not (math.isfinite(error) and error > 0.0):
        return number(value)
    text = f"{value:.{decimals(error, most=4)}f}"
    return text.replace("-", MINUS)


def _contrasts(results: Results) -> Iterator[Section]:
    if not results.contrasts:
        return
    groups: dict[str, list[Contrast]] = {}
    for contrast in without_repeats(results.contrasts):
        same = contrast.model_a if contrast.model_a == contrast.model_b else ""
        model = "" if results.chosen is not None else same
        groups.setdefault(_title(contrast.stratum, contrast.method, model), []).append(contrast)
    blocks: list[Block] = [
        Text(
            "Paired differences over subjects, b less a: mean with the 95 % interval, t-test, p "
            "and p after Holm's correction for the number of pairs, effect size (Cohen's d_z "
            "after Hedges). Weighted: by claimed errors, with the spread between subjects "
            "apart from the errors of estimation (random effects). `contrasts.csv` has it all."
        )
    ]
    for title, own in groups.items():
        shown = sorted(own, key=lambda c: (not c.p_holm < LEVEL, c.condition_a, c.condition_b))
        many = len({(c.condition_a, c.condition_b) for c in own}) > FEW
        if many:
            clear = [c for c in shown if c.p_holm < LEVEL or c.weighted_p_holm < LEVEL]
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
    if len({(c.condition_a, c.condition_b) for c in distinct}) <= FEW:
        return distinct, "differences between conditions, b less a"
    clear = [c for c in distinct if c.p_holm < LEVEL]
    return clear, f"differences between conditions with p < {LEVEL:g} after Holm's correction"


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
                Entry(f"{c.condition_a} → {c.condition_b}"),
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
            _group_words(r.stratum) or NONE,
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


def _by_condition(results: Results) -> list[list[ConditionSpread]]:
    groups: dict[tuple[object, ...], list[ConditionSpread]] = {}
    for spread in results.by_condition:
        key = (spread.stratum, spread.condition, spread.model, spread.method)
        groups.setdefault(key, []).append(spread)
    return list(groups.values())


def _runs(results: Results) -> Iterator[Section]:
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
            Picture.of(
                spread_figure(own),
                f"runs-{place}",
                alt,
                f"{alt}. Bars: 95 % by chi-squared; 1: as claimed.",
            )
        )
    yield Section("runs", "From run to run", blocks)


def _recordings(analysis: Analysis) -> Section:
    columns = [
        Column("recording", text=True),
        Column("model", text=True),
        Column("method", text=True),
        Column("runs"),
        Column("VAF %"),
        Column("outcome", text=True),
        Column("remarks", text=True),
    ]
    looks = dict(zip(analysis.parts, analysis.looks, strict=True))
    rows: list[list[str]] = []
    for fit in analysis.fits:
        if fit.run is not None:
            continue
        look = looks[fit.part]
        page = fit.content.get("page")
        name = f"[{fit.part.words}]({page})" if page else fit.part.words
        for place, e in enumerate(fit.content["estimates"]):
            told = [*(look["remarks"] if not place else ()), *e["remarks"]]
            rows.append(
                [
                    name,
                    fit.content["model"],
                    e["method"],
                    str(look["recording"]["runs"]),
                    number(math.nan if e["vaf"] is None else e["vaf"]),
                    e["outcome"],
                    "; ".join(told) or NONE,
                ]
            )
    caption = "Every recording, all runs together; the names lead to pages with figures"
    return Section("recordings", "Recordings", [Table(caption, columns, entries(rows))])


def _origin(results: Results, command: str, about: Mapping[str, str]) -> Section:
    versions = ", ".join(f"{name} {version}" for name, version in about.items())
    return Section(
        "origin",
        "How this was made",
        [Command("To make it again:", command), Text(f"Versions: {versions}.")],
    )
