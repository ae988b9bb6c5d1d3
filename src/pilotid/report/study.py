"""The report of a study, as a page and as Markdown, from its store alone."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import permutations
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from pilotid.naming.settings import shown
from pilotid.report import study_figures as figures
from pilotid.report.page import FIGURES, Figure, render, save_figures, write_page
from pilotid.report.study_tables import (
    RECORDER,
    VIOLATION,
    Ranking,
    advice,
    by_mean_loss,
    covered,
    failure_table,
    key_of,
    loss_of,
    matrices,
    mean_loss,
    ranked,
    ranking,
    read_trust,
    recorder_table,
    remark_table,
    start_table,
    trust_table,
    verdict,
)
from pilotid.study.judge import LIMITS, USABLE, is_ranked, sentence
from pilotid.study.scores import ALL, EFFICIENT, loss_text
from pilotid.study.table import Comparison, Entry
from pilotid.support.disk import write_file
from pilotid.support.format import Table, number, share, table

REFERENCE = "nominal"
OPEN = 3  # scenarios of which all is said at once; of more, of the first alone
FOLDED = 9  # scenarios from which on the contents leave them out
FEWEST = 20  # fits of a part of a population that can be its weakest

NUMBERS = (
    "Numbers: [summary.csv](summary.csv), all scores: [scores.csv](scores.csv), each fit: "
    "[estimates.csv](estimates.csv)."
)


def write_report(folder: Path, study: Comparison) -> Path:
    """Write report.html, report.md and the figures; equal stores give equal bytes.

    What a `trust.json` beside the store says comes first.

    The Markdown is the report in short: what the page folds, it leaves out.

    Parameters
    ----------
    folder
        Where to write.
    study
        What the store holds.

    Returns
    -------
    Path
        The page.
    """
    page, content = folder / "report.html", content_of(study)
    save_figures(folder / FIGURES, list(_figures(content)), kinds=("svg",))
    write_page(page, "study.html", **content)
    write_file(folder / "report.md", _in_short(content).encode("utf-8", "replace"))
    return page


def content_of(study: Comparison) -> dict[str, Any]:
    """What the page shows: sentences, tables and figures, by the names that its template has."""
    told, names = read_trust(study.folder), compared(study)
    words, losses, rankings = overview(study)
    recorders = [name for name in names if study.scenarios[name].family == RECORDER]
    trends, scenarios = _trends(study), [_scenario(study, name) for name in study.scenarios]
    contents = [
        *[("trust", "What the fit is worth")] * bool(told),
        ("summary", "Which method to use"),
        *[("recorders", "What your recorder may do to you")] * bool(recorders),
        *([(own["key"], own["title"]) for own in scenarios] if len(scenarios) < FOLDED else []),
        ("provenance", "Provenance"),
    ]
    return {
        "title": "Pilot-model identification: methods compared",
        "contents": contents,
        "trust": told and (advice(told), trust_table(told), told["unknown"]),
        "words": words,
        "losses": losses,
        "rankings": rankings,
        "sentences": _sentences(study, names[0]) if len(names) == 1 else [],
        "cost": _cost(study, names),
        "limits": {"exact": EFFICIENT, "rules": LIMITS} if names else None,
        "recorders": recorder_table(study, recorders) if recorders else None,
        "scenarios": scenarios,
        "trends": trends,
        "failures": failure_table(study),
        **provenance(study),
    }


def _figures(content: dict[str, Any]) -> Iterator[Figure]:
    yield from [content["cost"]] * bool(content["cost"])
    for own in content["scenarios"]:
        yield from own["figures"]
    yield from content["trends"]


def _in_short(content: dict[str, Any]) -> str:
    """The report as Markdown, without what the page folds."""
    folded = {own["key"] for own in content["scenarios"]}
    there = {key: name for key, name in content["contents"] if key not in folded}
    text = render("study.md", there=there, **content)
    # What links to a section that is left out stays as words.
    link = r"\[([^\]]+)\]\(#([\w-]+)\)"
    return re.sub(link, lambda found: found[0] if found[2] in there else found[1], text)


def overview(
    study: Comparison, *, widest: int = 21
) -> tuple[list[str], list[Table], list[Ranking]]:
    """The answer in sentences and tables, which the terminal and the page's first screen show.

    At most `widest` scenarios stand beside one another; 0 for none.
    """
    names = compared(study)
    shown = names if len(names) <= OPEN else [_reference(names)]
    words = [answer(study, name) for name in shown]
    rankings = [ranking(study, name) for name in shown]
    if prior := [f"`{m}`" for m, entry in study.methods.items() if entry.uses_prior]:
        words.append(
            f"* {', '.join(prior)} use prior knowledge: the range that parameters of pilots "
            "usually have. `bayes(prior=3)` has priors three times as wide."
        )
        words += [wider for name in shown for wider in _wider_priors(study, name)]
    if len(names) < 2:
        return words if study.scenarios else ["The study holds no fits yet."], [], rankings
    return [_over_all(study, names), *words], matrices(study, names, widest), rankings


def _wider_priors(study: Comparison, name: str) -> Iterator[str]:
    """How the loss changes where a method's prior is wider, in words."""
    entries = {m: e for m, e in study.methods.items() if e.uses_prior}
    for (narrow, first), (wide, second) in permutations(entries.items(), 2):
        same = {**first.settings, "prior": None} == {**second.settings, "prior": None}
        if same and second.number("prior") > first.number("prior"):
            words = f"In `{name}`, `{wide}` has {loss_text(*study.ratio(name, wide, narrow))}"
            yield f"{words} times the loss of `{narrow}`: the effect of its prior."


def _over_all(study: Comparison, names: Sequence[str]) -> str:
    """Which method to take where it is not known which scenario is the nearest."""
    means = {
        method: mean_loss(losses)
        for method, losses in by_mean_loss(study, names).items()
        if len(losses) == len(names)
    }
    if not means:
        return f"No method is ranked in all {len(names)} scenarios."
    best, *others = means
    words = f"Over these {len(names)} scenarios **`{best}` is best**: geometric mean "
    return f"{words}{loss_text(means[best])}" + (
        f", then `{others[0]}`, {loss_text(means[others[0]])}." if others else "."
    )


def compared(study: Comparison) -> list[str]:
    """Scenarios and populations of which means say something."""
    return [name for name, entry in study.scenarios.items() if not entry.one_recording]


def _reference(names: Sequence[str]) -> str:
    return REFERENCE if REFERENCE in names else names[0]


def answer(study: Comparison, name: str) -> str:
    """Which method to take in a scenario, how much better it is than the next, which to avoid."""
    every = ranked(study, name)
    order = [row for row in every if is_ranked(row)]
    if not order:
        return f"On `{name}` no method can be ranked: none gives intervals and seldom fails."
    best, *others = order
    grade, loss = verdict(study, best).grade, loss_text(*loss_of(best))
    count = f" of {len(every)}" if others else ""
    words = f"On `{name}`, **`{best.method}` is best**{count}: loss {loss}, {grade}."
    if grade == "poor":
        words = (
            f"On `{name}` no method is good enough: `{best.method}`, the best, is poor, with a "
            f"loss of {loss}."
        )
    ratios = {row.method: study.ratio(name, row.method, best.method) for row in others}
    alike = [method for method, (_, low, high) in ratios.items() if low <= 1.0 <= high]
    if alike:
        listed = ", ".join(f"`{method}`" for method in alike)
        words += f" Not clearly worse (the ratio of losses may be 1): {listed}."
    worse = next((method for method in ratios if method not in alike), None)
    if worse is not None:
        words += f" Next, clearly worse: `{worse}`, {loss_text(*ratios[worse])} times that loss."
    poor = [f"`{row.method}`" for row in others if row.loss_lower >= USABLE]
    if poor and grade != "poor":
        words += f" **Do not use** {', '.join(poor)}: loss surely above {USABLE:g}."
    return words


def _sentences(study: Comparison, name: str) -> list[str]:
    """What a reader should know of each method in a scenario."""
    return [sentence(row.method, study.scored(name, row.method)) for row in ranked(study, name)]


def _cost(study: Comparison, names: Sequence[str]) -> Figure | None:
    """Loss over time in the reference scenario."""
    order = ranked(study, _reference(names)) if names else []
    if not any(row.seconds > 0.0 and row.loss > 0.0 for row in order):
        return None
    name = order[0].scenario
    return Figure(
        "cost",
        figures.cost(order),
        f"`{name}`: loss with its 95 % interval, and what a fit takes on one core. "
        f"Stepped line: no other method is both faster and better. {NUMBERS}",
        f"Loss of each method in {name} over the median time of a fit",
    )


def _scenario(study: Comparison, name: str) -> dict[str, Any]:
    """All on one scenario or population, which the page folds."""
    entry, names = study.scenarios[name], compared(study)
    usable = [row.method for row in study.of(name).itertuples() if row.usable]
    power = entry.remnant
    remnant = "" if power is None else f"; remnant {100 * power:.0f} % of the control's power"
    what = f"{entry.description[:1].upper()}{entry.description[1:]}{remnant}"
    apart = len(names) > OPEN and name != _reference(names)
    known = name in names and len(names) > 1
    tables = [remark_table(study, name)] if entry.family in (RECORDER, VIOLATION) else []
    drawn: list[Figure] = []
    if entry.one_recording:
        tables.append(start_table(study, name))
    elif entry.population:
        drawn = _population(study, name, usable)
    elif usable:
        drawn = [_errors(study, name)]
    return {
        "key": key_of(name),
        "title": f"Scenario {name}",
        "what": f"{what}; model {entry.model}.",
        "ranking": ranking(study, name) if known and apart else None,
        "sentences": _sentences(study, name) if known else [],
        "tables": tables,
        "weak": _weakest(study, name, usable) if entry.population else [],
        "figures": drawn,
    }


def _errors(study: Comparison, name: str) -> Figure:
    return Figure(
        f"errors-{key_of(name)}",
        figures.errors(study, name),
        f"Scenario {name}: mean error, standard deviation and claimed standard error beside the "
        f"Cramér-Rao bound. Each panel has its own scale; a triangle marks a method whose "
        f"mean error lies outside it. {NUMBERS}",
        f"Mean error and scatter of each parameter by each method in scenario {name}",
    )


def _population(study: Comparison, name: str, methods: Sequence[str]) -> list[Figure]:
    """Where in a population methods are weak, and how their errors are distributed."""
    key = key_of(name)
    if not study.of(name).n.any():
        return []
    return [
        Figure(
            f"coverage-{key}",
            figures.by_stratum(study, name, methods),
            f"`{name}`: share of the 95 % intervals that hold the truth, over all parameters, in "
            "parts of the recordings. Bars: 95 % Monte Carlo intervals; grey: 93.5 to 96.5 %; a "
            "hollow triangle marks a share to the left of the axis. "
            "Numbers: [population.csv](population.csv).",
            f"Coverage of 95 % intervals by part of {name} and method",
        ),
        Figure(
            f"errors-{key}",
            figures.by_parameter(study, name, methods),
            f"`{name}`: error over claimed error in ascending order, against the quantiles of a "
            "normal distribution, where an exact method lies on the line. Grey: where 95 % of each "
            f"quantile would lie for as many recordings. {NUMBERS}",
            f"Quantiles of standardised errors in {name} by parameter and method",
        ),
    ]


def _weakest(study: Comparison, name: str, methods: Sequence[str]) -> list[str]:
    """The part of a population where each method loses most, in words."""
    rows = study.scores[(study.scores.scenario == name) & (study.scores.parameter == ALL)]
    rows = rows[rows.method.isin(methods)]
    divided = rows.groupby(["method", "stratum"]).value.transform("nunique") > 1
    found = rows[divided & (rows.recordings >= FEWEST) & np.isfinite(rows.loss)]
    words = []
    for _, own in found.groupby("method", sort=False):
        row = max(own.itertuples(), key=lambda row: (row.loss, f"{row.stratum} {row.value}"))
        words.append(
            f"`{row.method}` loses most in {row.stratum} {row.value}: {number(row.loss)} in "
            f"{row.recordings} fits, coverage {share(*covered(row))} %."
        )
    return words


def _trends(study: Comparison) -> list[Figure]:
    """Errors over the one number in which the scenarios of a family differ."""
    varied = {
        str(e.settings["varied"]): e.family
        for e in study.scenarios.values()
        if e.family and e.settings.get("varied")
    }
    drawn: list[Figure] = []
    for path, family in varied.items():
        own = [e for e in study.scenarios.values() if e.family == family]
        points = {e.number(path): e.name for e in own}
        near = study.scenarios.get(REFERENCE)
        same = [near] if near and near.model == own[0].model else []
        points = {e.number(path): e.name for e in same} | points
        known = [(name, x) for x, name in points.items() if x > 0.0]
        if len(known) < 2:
            continue
        labels = (path, "rmse [% of true value]")
        figure = figures.sweep(study, known, labels)
        alt = f"Root mean square error by parameter and method over {path}"
        caption = f"Root mean square error and Cramér-Rao bound over `{path}`. {NUMBERS}"
        drawn.append(Figure(f"trend-{family}", figure, caption, alt))
    return drawn


# ------------------------------------------------------------------------------ provenance

#: Facts on a study that are no versions.
OWN_FACTS = ("format", "seed", "code")


def command(study: Comparison) -> str:
    """What to type for the whole study."""
    entries = study.methods.items()
    methods = [e.typed or own for own, e in entries if "estimates" not in e.settings]
    imported = dict.fromkeys(f"{e.typed} " for _, e in entries if "estimates" in e.settings)
    names = dict.fromkeys(entry.typed or name for name, entry in study.scenarios.items())
    return (
        f"pilotid compare --scenario {quote(','.join(names))} --method {quote(','.join(methods))} "
        f"--replications {study.replications()} --seed {study.about.get('seed', '?')} "
        f"{''.join(imported)}--out results/compare"
    )


def provenance(study: Comparison) -> dict[str, Any]:
    """All that defines methods and scenarios, seed, versions, and how to make the numbers again."""
    about = study.about
    facts = ", ".join(f"{key} {value}" for key, value in about.items() if key not in OWN_FACTS)
    methods = [(label, f"`{shown(entry.settings)}`") for label, entry in study.methods.items()]
    scenarios = [
        (e.name, e.description, e.model, _start(e), f"`{shown(e.settings)}`")
        for e in study.scenarios.values()
    ]
    titles = ("scenario", "description", "model", "start", "all that defines it")
    return {
        "commands": [
            (
                "The whole study (resumes an interrupted one; the same numbers for any number of "
                "workers):",
                command(study),
            ),
            ("This report again, from the store alone:", "pilotid report DIR"),
        ],
        "seed": f"Seed {about.get('seed', '?')}, code digest {about.get('code', '?')}; {facts}.",
        "methods": table(methods, "Methods", ("method", "settings")),
        "settings": table(scenarios, "Scenarios", titles),
    }


def _start(entry: Entry) -> str:
    """Which initial guesses methods are handed, in words."""
    spread = entry.number("start_spread")
    return f"drawn within {100.0 * spread:g} % of the truth" if spread > 0.0 else "of the model"
