"""The report of a study, as a page and as Markdown, from its store alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any

from pilotid.naming.settings import shown
from pilotid.report import study_figures as figures
from pilotid.report.study_tables import (
    RECORDER,
    VIOLATION,
    all_numbers,
    by_mean_loss,
    failure_table,
    key_of,
    matrices,
    mean_loss,
    ranked,
    ranking,
    read_trust,
    recorder_table,
    remark_table,
    trust_section,
)
from pilotid.study.comparison import ALL, Comparison, MethodResults, loss_ratios
from pilotid.study.judge import RULES, USABLE, judge, sentence
from pilotid.study.scores import EFFICIENT, loss_text
from pilotid.support.disk import write_file
from pilotid.support.document import (
    Block,
    Bullets,
    Command,
    Figure,
    Section,
    Table,
    Text,
    table_of,
    to_markdown,
    write_page,
)
from pilotid.support.format import number, share

TITLE = "Pilot-model identification: methods compared"
REFERENCE = "nominal"
OPEN = 3  # scenarios of which all is said at once; of more, of the first alone
FEWEST = 20  # fits of a part of a population that can be its weakest

LOSS = (
    "**Loss**: for each parameter of each fit the interval score of its 95 % interval (width, plus "
    "40 times the distance by which it misses the truth), over the score that an exact and "
    f"efficient estimator has on that recording ({EFFICIENT:.3f} Cramér-Rao bounds). Such an "
    "estimator has **1** on average, a few recordings may give less, and bias, scatter, and "
    "intervals too short or too long all cost. Mean over recordings, geometric mean over "
    "parameters; in parentheses a 95 % bootstrap interval over recordings. A fit that failed is "
    "charged with the interval from zero to twice the true value. A method without intervals is "
    "ranked behind the others, by its rmse over the bound."
)
COLUMNS = (
    "**Times best**: the ratio of losses on the same recordings, with an interval of its own; if "
    "it holds 1, the recordings do not tell the two apart, whatever the colours of their losses. "
    "**Largest bias/error**: mean error in claimed standard errors, with its Monte Carlo error. "
    "**Coverage**: share of the 95 % intervals that hold the truth, with its 95 % interval."
)
NUMBERS = "Numbers: [summary.csv](summary.csv), each fit: [estimates.csv](estimates.csv)."


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
    told = read_trust(study.folder)
    sections = [*([trust_section(told)] if told else []), *report_sections(study)]
    page = folder / "report.html"
    write_page(page, TITLE, sections, kinds=("svg",))
    short = to_markdown(TITLE, [section.in_short() for section in sections if not section.folded])
    write_file(folder / "report.md", short.encode("utf-8", "replace"))
    return page


def overview(study: Comparison, *, widest: int = 21) -> tuple[list[str], list[Table[Any]]]:
    """The answer in sentences and tables, which the terminal and the page's first screen show.

    At most `widest` scenarios stand beside one another; 0 for none.
    """
    names = compared(study)
    shown = names if len(names) <= OPEN else [_reference(names)]
    words = [answer(study.of(name)) for name in shown]
    tables: list[Table[Any]] = [ranking(study.of(name)) for name in shown]
    if len(names) > 1:
        words.insert(0, _over_all(study, names))
        tables = [*matrices(study, names, widest), *tables]
    return words, tables


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
    words = f"Over these {len(names)} scenarios **`{best}` is best**: mean loss "
    return f"{words}{loss_text(means[best])}" + (
        f", then `{others[0]}`, {loss_text(means[others[0]])}." if others else "."
    )


def compared(study: Comparison) -> list[str]:
    """Scenarios and populations of which means say something."""
    return [entry.name for entry in study.scenarios if not entry.one_recording]


def _reference(names: Sequence[str]) -> str:
    return REFERENCE if REFERENCE in names else names[0]


def answer(cells: Sequence[MethodResults]) -> str:
    """Which method to take in a scenario, how much better it is than the next, which to avoid."""
    name = cells[0].scenario.name
    order = [cell for cell in ranked(cells) if math.isfinite(cell.overall.loss.value)]
    if not order:
        return f"On `{name}` no method can be ranked: none gives intervals."
    best, *others = order
    grade = judge(best.scores).grade
    count = f" of {len(cells)}" if others else ""
    words = f"On `{name}`, **`{best.method}` is best**{count}: loss {best.overall.loss}, {grade}."
    if grade == "poor":
        words = (
            f"On `{name}` no method is good enough: `{best.method}`, the best, is poor, with a "
            f"loss of {best.overall.loss}."
        )
    alike = [cell for cell in others if (r := loss_ratios(cell, best)[ALL]).lower <= 1.0 <= r.upper]
    if alike:
        listed = ", ".join(f"`{cell.method}`" for cell in alike)
        words += f" Not clearly worse (the ratio of losses may be 1): {listed}."
    worse = next((cell for cell in others if cell not in alike), None)
    if worse is not None:
        ratio = loss_ratios(worse, best)[ALL]
        words += f" Next, clearly worse: `{worse.method}`, {ratio} times that loss."
    poor = [f"`{cell.method}`" for cell in others if cell.overall.loss.lower >= USABLE]
    if poor and grade != "poor":
        words += f" **Do not use** {', '.join(poor)}: loss surely above {USABLE:g}."
    return words


def report_sections(study: Comparison) -> list[Section]:
    """The report's sections: the answer, all on each scenario, failures, provenance."""
    if not study.cells:
        return [Section("summary", "Summary", [Text("The study holds no fits yet.")])]
    names = compared(study)
    return [
        _summary(study),
        *_recorders(study, names),
        *(_scenario(study, name) for name in study.names),
        *_trends(study),
        failures(study),
        provenance(study),
    ]


def _summary(study: Comparison) -> Section:
    blocks: list[Block] = []
    words, tables = overview(study)
    names = compared(study)
    blocks += [Text(" ".join(words)) if len(words) == 1 else Bullets(words), *tables]
    if names:
        name = _reference(names)
        order = ranked(study.of(name))
        if len(names) == 1:
            blocks.append(Bullets([sentence(cell.method, cell.scores) for cell in order]))
        if any(cell.seconds > 0.0 and cell.overall.loss.value > 0.0 for cell in order):
            caption = (
                f"`{name}`: loss with its 95 % interval, and what a fit takes on one core. "
                f"Stepped line: no other method is both faster and better. {NUMBERS}"
            )
            alt = f"Loss of each method in {name} over the median time of a fit"
            blocks.append(Figure("cost", figures.cost(order), caption, alt))
        blocks += [Text(LOSS), Text(COLUMNS), Text(RULES)]
    return Section("summary", "Which method to use", blocks)


def _recorders(study: Comparison, names: Sequence[str]) -> list[Section]:
    """What faulty recorders do to each method."""
    own = [name for name in names if study.entry(name).family == RECORDER]
    if not own:
        return []
    return [Section("recorders", "What your recorder may do to you", [recorder_table(study, own)])]


def _scenario(study: Comparison, name: str) -> Section:
    """All on one scenario or population."""
    entry, cells = study.entry(name), study.of(name)
    power = study.remnant_ratio(name)
    remnant = f"; remnant {100 * power:.0f} % of the control's power" if power == power else ""
    what = f"{entry.description[:1].upper()}{entry.description[1:]}{remnant}"
    blocks: list[Block] = [Text(f"{what}; model {entry.model}.")]
    names = compared(study)
    if name in names and len(names) > OPEN and name != _reference(names):
        blocks.append(ranking(cells))
    if name in names and len(names) > 1:
        blocks.append(Bullets([sentence(cell.method, cell.scores) for cell in ranked(cells)]))
    if entry.family in (RECORDER, VIOLATION):
        blocks.append(remark_table(cells))
    blocks += details(cells, name)
    return Section(key_of(name), f"Scenario {name}", blocks, folded=True)


def details(cells: Sequence[MethodResults], key: str) -> list[Block]:
    """Figures, which `key` names, and all numbers of a scenario or a population."""
    entry, usable = cells[0].scenario, [cell for cell in cells if cell.usable]
    blocks: list[Block] = []
    if entry.one_recording:
        return [all_numbers(cells)]
    if entry.population:
        blocks = _population(key, usable)
    elif usable:
        blocks = [_errors(key, usable)]
    return [*blocks, all_numbers(cells)]


def _errors(key: str, cells: Sequence[MethodResults]) -> Figure:
    name = cells[0].scenario.name
    return Figure(
        f"errors-{key}",
        figures.errors(cells),
        f"Scenario {name}: mean error, standard deviation and claimed standard error beside the "
        f"Cramér-Rao bound. Each panel has its own scale; a triangle marks a method whose "
        f"mean error lies outside it. {NUMBERS}",
        f"Mean error and scatter of each parameter by each method in scenario {name}",
    )


def _population(key: str, cells: Sequence[MethodResults]) -> list[Block]:
    """Where in a population methods are weak, and how their errors are distributed."""
    if not cells:
        return []
    name = cells[0].scenario.name
    weak = [words for cell in cells if (words := _weakest(cell))]
    blocks: list[Block] = [Bullets(weak)] if weak else []
    if not any(cell.overall.n for cell in cells):
        return blocks
    return [
        *blocks,
        Figure(
            f"coverage-{key}",
            figures.by_stratum(cells),
            f"`{name}`: share of the 95 % intervals that hold the truth, over all parameters, in "
            "parts of the recordings. Bars: 95 % Monte Carlo intervals; grey: 93.5 to 96.5 %; a "
            "hollow triangle marks a share to the left of the axis. "
            "Numbers: [population.csv](population.csv).",
            f"Coverage of 95 % intervals by part of {name} and method",
        ),
        Figure(
            f"errors-{key}",
            figures.by_parameter(cells),
            f"`{name}`: error over claimed error in ascending order, against the quantiles of a "
            "normal distribution, where an exact method lies on the line. Grey: where 95 % of each "
            f"quantile would lie for as many recordings. {NUMBERS}",
            f"Quantiles of standardised errors in {name} by parameter and method",
        ),
    ]


def _weakest(cell: MethodResults) -> str:
    """The part of a population where a method loses most, in words."""
    found = [
        (scores[0].loss.value, f"{name} {value}", scores[0])
        for (name, value), scores in cell.parts.items()
        if len(cell.strata[name]) > 1
        and scores[0].tried >= FEWEST
        and math.isfinite(scores[0].loss.value)
    ]
    if not found:
        return ""
    loss, where, own = max(found, key=lambda each: each[:2])
    covered = share(own.coverage.value, own.coverage_interval)
    return (
        f"`{cell.method}` loses most in {where}: {number(loss)} in {own.tried} fits, "
        f"coverage {covered} %."
    )


def _trends(study: Comparison) -> list[Section]:
    """Errors over the one number in which the scenarios of a family differ."""
    varied = {
        str(e.settings["varied"]): e.family
        for e in study.scenarios
        if e.family and e.settings.get("varied")
    }
    blocks: list[Block] = []
    for path, family in varied.items():
        own = [e for e in study.scenarios if e.family == family]
        points = {e.number(path): e.name for e in own}
        same = [e for e in study.scenarios if e.name == REFERENCE and e.model == own[0].model]
        points = {e.number(path): e.name for e in same} | points
        known = [(name, x) for x, name in points.items() if x > 0.0]
        if len(known) < 2:
            continue
        labels = (path, "rmse [% of true value]")
        figure = figures.sweep(study, known, labels)
        alt = f"Root mean square error by parameter and method over {path}"
        caption = f"Root mean square error and Cramér-Rao bound over `{path}`. {NUMBERS}"
        blocks.append(Figure(f"trend-{family}", figure, caption, alt))
    return [Section("trends", "Trends", blocks, folded=True)] if blocks else []


# ------------------------------------------------------------------------------ provenance

#: Facts on a study that are no versions.
OWN_FACTS = ("format", "seed", "code")


def command(study: Comparison) -> str:
    """What to type for the whole study."""
    methods = [entry.typed or own for own, entry in study.entries.items()]
    names = dict.fromkeys(study.entry(name).typed or name for name in study.names)
    return (
        f"pilotid compare --scenario {quote(','.join(names))} --method {quote(','.join(methods))} "
        f"--replications {study.replications(study.names)} --seed {study.about.get('seed', '?')} "
        f"--out results/compare"
    )


def failures(study: Comparison) -> Section:
    """Which fits failed, and why."""
    table = failure_table(study)
    text = (
        "A failure counts in the loss as the interval from zero to twice the true value; bias, "
        "scatter, rmse and coverage are those of the fits that count. A recording that a method "
        "cannot treat is no try."
    )
    every = Text("Every fit of this study converged.")
    return Section(
        "failures",
        "Failures and their reasons",
        [Text(text), table if table.items else every],
        folded=True,
    )


def provenance(study: Comparison) -> Section:
    """All that defines methods and scenarios, seed, versions, and how to make the numbers again."""
    about = study.about
    facts = ", ".join(
        f"{key} {value}"
        for key, value in about.items()
        if key not in OWN_FACTS and not key.startswith("remnant ratio")
    )
    seed = f"Seed {about.get('seed', '?')}, code digest {about.get('code', '?')}; {facts}."
    methods = [(label, f"`{shown(entry.settings)}`") for label, entry in study.entries.items()]
    scenarios = [
        (e.name, e.description, e.model, e.start, f"`{shown(e.settings)}`") for e in study.scenarios
    ]
    heads = ("scenario", "description", "model", "start", "all that defines it")
    blocks: list[Block] = [
        Command(
            "The whole study (resumes an interrupted one; the same numbers for any number of "
            "workers):",
            command(study),
        ),
        Command("This report again, from the store alone:", "pilotid report DIR"),
        Text(
            "No method is told the truth. All methods have the same recordings and are handed the "
            "same **start**: that of the model, or one drawn at random where the scenarios say so. "
            f"{seed}"
        ),
        table_of("Methods", [("method",), ("settings",)], methods, folded=True),
        table_of("Scenarios", [(title,) for title in heads], scenarios, folded=True),
    ]
    return Section("provenance", "Provenance", blocks)
