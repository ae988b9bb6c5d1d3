"""The report of an analysis: summary, models, estimates, contrasts, recordings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pilotid.analysis.analyse import Analysis, group_of, group_words
from pilotid.analysis.figures import (
    estimates_figure,
    parts_figure,
)
from pilotid.analysis.report_tables import (
    FEW,
    alarms,
    contrast_tables,
    counted,
    difference_words,
    estimate_groups,
    factor_table,
    is_headline,
    is_significant,
    left_out_table,
    means_table,
    model_table,
    recording_table,
)
from pilotid.analysis.results import Results
from pilotid.analysis.rows import MEASURED, SUBJECT, grouped
from pilotid.estimates.estimate import Outcome
from pilotid.report.page import FIGURES, Figure, save_figures, write_page
from pilotid.support.format import Table
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import LEVEL

MOST = 6  # differences that the summary names


def write_report(folder: Path, results: Results, command: str, about: Mapping[str, str]) -> Path:
    """Write report.html, and its figures as SVG and PDF.

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
    path = folder / "report.html"
    analysis = results.analysis
    tables = list(contrast_tables(results)) if results.contrasts else []
    left_out = left_out_table(analysis.left_out) if analysis.left_out else None
    sections = {
        "summary": "Summary",
        "models": "Which model",
        "estimates": "Estimates" if results.shown else "",
        "conditions": "Conditions compared" if tables else "",
        "left-out": "Runs left out" if left_out else "",
        "recordings": "Recordings",
        "origin": "How this was made",
    }
    estimates = list(_estimates(results))
    figures = [figure for _, figure in estimates if figure]
    save_figures(folder / FIGURES, figures)
    write_page(
        path,
        "experiment.html",
        title="Pilot models of recorded subjects",
        contents=[(key, name) for key, name in sections.items() if name],
        **_summary(results),
        excluded=[part.words for part in analysis.settings.excluded],
        refused=list(analysis.refused),
        choices=[
            f"**{group_words(group)}** {choice.reason.replace('+-', '±')}"
            for group, choice in analysis.choices.items()
            if choice.reason
        ],
        models=model_table(analysis),
        estimates=estimates,
        contrasts=tables,
        across=any(c.across for c in results.contrasts),
        effects=factor_table(results.effects) if results.effects else None,
        left_out=left_out,
        recordings=recording_table(analysis),
        command=command,
        versions=", ".join(f"{name} {version}" for name, version in about.items()),
    )
    return path


def _summary(results: Results) -> dict[str, Any]:
    """The first sentence, and what a reader must know first, a sentence each."""
    analysis = results.analysis
    fields = [dict(part.fields) for part in analysis.parts]
    subjects = {own[SUBJECT] for own in fields if SUBJECT in own}
    runs = sum(int(look["recording"]["runs"]) for look in analysis.looks.values())
    of = f" of {len(subjects)} subjects" if subjects else ""
    items: list[str] = []
    if results.chosen is not None:
        chosen = grouped(analysis.choices, lambda group: analysis.choices[group].model)
        items += [
            f"Model `{model}`: {'; '.join(group_words(group) or 'all' for group in where)}."
            for model, where in chosen.items()
        ]
    items += _contrasted(results)
    items += _changing(analysis)
    ends = [
        (e["outcome"], f"{fit.part.words}, {e['method']}")
        for fit in analysis.fits
        if fit.run is None
        for e in fit.content["estimates"]
    ]
    words = {outcome.slug: outcome.value.replace(":", ",") for outcome in Outcome}
    for outcome in dict.fromkeys(how for how, _ in ends if how != "converged"):
        where = [place for how, place in ends if how == outcome]
        more = f", and {len(where) - FEW} more" if len(where) > FEW else ""
        items.append(
            f"{len(where)} of {len(ends)} fits {words[outcome]} ({'; '.join(where[:FEW])}{more})."
        )
    items += alarms(analysis)
    items += results.notes
    return {"size": f"{len(analysis.parts)} recordings{of}, {runs} runs.", "summary": items}


def _contrasted(results: Results) -> Iterator[str]:
    """How many contrasts are significant, who is left out of them, and which are in doubt."""
    if not results.contrasts:
        return
    every = counted(results.contrasts)
    clear = [c for c in every if is_significant(c)]
    told = f"{len(clear)} of {len(every)} {_compared(results)} have p < {LEVEL:g}"
    quantities = {(c.stratum, c.method, c.parameter) for c in every}
    told += (
        " (Holm's correction is for the pairs of conditions, not for the number of quantities: "
        f"by chance about {LEVEL * len(quantities):.2g} of {len(quantities)} quantities would)"
    )
    told_first = sorted(clear, key=lambda c: (c.method == MEASURED, not is_headline(c), c.p_holm))
    named = "; ".join(map(difference_words, told_first[:MOST]))
    more = f"; and {len(clear) - MOST} more" if len(clear) > MOST else ""
    yield told + (f": {named}{more} ([all](#conditions))." if clear else ".")
    out: dict[str, dict[str, list[str]]] = {}
    for c in results.contrasts:
        for reason in c.left_out:
            pair = " ".join(
                (*(value for _, value in c.stratum), f"{c.condition_a}:{c.condition_b}")
            )
            out.setdefault(reason, {}).setdefault(pair, []).append(c.parameter)
    for reason, pairs in out.items():
        where = ", ".join(f"{pair} ({', '.join(keys)})" for pair, keys in pairs.items())
        yield f"Left out of the contrasts {where}: {reason}."
    if across := sum(c.across for c in results.contrasts):
        yield f"{across} differences are across models and count in no summary."
    others = {(c.condition_a, c.model_a, c.condition_b, c.model_b): None for c in results.contrasts}
    for a, model_a, b, model_b in others:
        if model_a != model_b:
            yield (
                f"{a} (`{model_a}`) and {b} (`{model_b}`) have different models: their differences "
                "are partly those of the models. With `--model NAME` both have the same."
            )
    doubted = [c for c in clear if c.misspecified]
    who = dict.fromkeys(
        f"{c.method}, {place}" for c in results.contrasts for place in c.misspecified
    )
    if who:
        yield (
            "The lines of the forcing functions contradict the fits of "
            f"{'; '.join(who)}: {len(doubted)} of the {len(clear)} significant differences are "
            "made with them. Set `--method fourier` beside them, and do not believe what differs."
        )


def _compared(results: Results) -> str:
    """What contrasts are differences of."""
    within = {contrast.within for contrast in results.contrasts}
    between = "differences between conditions"
    if len(within) > 1:
        return f"{between}, or between parameters of the same fits,"
    return "differences between parameters of the same fits" if True in within else between


def _changing(analysis: Analysis) -> list[str]:
    """In which recordings gains and leads change, under the constant model that suits best."""
    told: dict[str, list[bool]] = {}
    for group, choice in analysis.choices.items():
        for part in (part for part in analysis.parts if group_of(part) == group):
            constant = [c for c in analysis.candidates(part) if math.isfinite(c.change_p)]
            if constant:
                own = min(constant, key=lambda c: (c.model != choice.model, c.aicc))
                told.setdefault(group_words(group) or "all", []).append(own.changes)
    every = [changes for own in told.values() for changes in own]
    if not any(every):
        return []
    where = [f"{words} {sum(own)} of {len(own)}" for words, own in told.items() if any(own)]
    return [
        f"A gain or lead changes by a third or more during {sum(every)} of {len(every)} recordings "
        f"(a constant pilot is rejected, p < {ESTIMATE.changes:g}; the warning `gains-change` asks "
        f"for p < {ESTIMATE.seldom:g}): {', '.join(where)}. "
        "`adapting` is a model of such pilots."
    ]


def _estimates(results: Results) -> Iterator[tuple[Table, Figure | None]]:
    """Estimates over conditions: a table and its figure."""
    place = measured = 0
    for title, group in estimate_groups(results.shown, results.chosen):
        means, figure = means_table(group, title), None
        if group[0].method == MEASURED:
            bars = parts_figure(group)
            if bars is not None:
                caption = f"What variances are made of, {title}: means over subjects."
                measured += 1
                figure = Figure(f"variances-{measured}", bars, caption)
        else:
            place += 1
            caption = (
                f"Estimates over conditions, {title}. Bars: 95 % from the claimed errors; "
                "black: means over subjects. Long bars are cut."
            )
            figure = Figure(f"estimates-{place}", estimates_figure(group), caption)
        yield means, figure
