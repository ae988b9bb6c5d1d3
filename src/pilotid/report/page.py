"""The report of a study, as a page and as Markdown, from its store alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pilotid.disk import write_file
from pilotid.numbers import MINUS, NONE, number
from pilotid.report import appendix
from pilotid.report import glance as study_glance
from pilotid.report import tables as study_tables
from pilotid.report.adapting import adapting_chapters
from pilotid.report.chapters import Chapter, chapters, ratio
from pilotid.report.content import (
    Block,
    Bullets,
    Command,
    Entry,
    Picture,
    Section,
    Text,
    markdown,
    web_page,
    write_pictures,
)
from pilotid.report.population import links_of, population_chapters
from pilotid.report.population_verdicts import CODES as POPULATION_CODES
from pilotid.report.population_verdicts import RULES as POPULATION_RULES
from pilotid.report.population_verdicts import population_verdicts
from pilotid.report.rules import Rules, rules_for
from pilotid.report.timing import timing
from pilotid.report.verdicts import CODES, in_short, judge, sentence
from pilotid.report.violations import violation_chapters
from pilotid.study.comparison import Comparison
from pilotid.study.store import Store

if TYPE_CHECKING:
    from rich.table import Table as RichTable

TITLE = "Pilot-model identification: methods compared"
REFERENCE = "nominal"


def write_report(
    folder: Path, store: Store, study: Comparison, *, pdf: bool = False, above: str = ""
) -> Path:
    """Write report.html, report.md and the figures; equal stores give equal bytes.

    Parameters
    ----------
    folder
        Where to write.
    store
        The study's store.
    study
        What the store holds.
    pdf
        Whether figures are written as PDF too.
    above
        The page above this one, if there is one.

    Returns
    -------
    Path
        The page.
    """
    sections = _sections(study, store)
    if pdf:
        sections = [section.with_pdfs() for section in sections]
    write_pictures(folder, sections)
    write_file(folder / "report.md", markdown(TITLE, sections).encode("utf-8", "replace"))
    page = folder / "report.html"
    write_file(page, web_page(TITLE, sections, above).encode("utf-8", "replace"))
    return page


def overview_table(study: Comparison) -> RichTable:
    """The summary as a table for the terminal."""
    from pilotid.terminal import make_table

    table = make_table()
    for title in ("method", "verdict", "largest bias"):
        table.add_column(title)
    for title in ("fits", "rmse/bound", "coverage %", "ms/fit"):
        table.add_column(title, justify="right")
    if not study.scenarios:
        return table
    name = reference(study)
    table.title, table.title_justify, table.title_style = _overview_title(study, name), "left", ""
    rules = rules_for(study.cells)
    for cell in study.of(name):
        row = (
            cell.method,
            judge(cell, rules).words,
            study_tables.largest_bias(cell),
            f"{cell.usable}/{cell.tried}",
            study_tables.worst_rmse(cell),
            study_tables.span(cell, lambda s: 100.0 * s.coverage),
            number(cell.milliseconds),
        )
        # A terminal may lack these two signs.
        plain = (text.replace(MINUS, "-").replace(NONE, "-") for text in row)
        table.add_row(*plain)
    return table


def reference(study: Comparison) -> str:
    """The scenario that the summary is about."""
    if REFERENCE in study.names:
        return REFERENCE
    several = [entry.name for entry in study.scenarios if not entry.one_recording]
    return (several or study.names)[0]


def _overview_title(study: Comparison, name: str) -> str:
    return (
        f"{name}, {_recordings(study, name)}; bias as a multiple of the bound; rmse: median, worst"
    )


def _recordings(study: Comparison, name: str) -> str:
    count = study.replications([name])
    return "1 recording" if count == 1 else f"{count} recordings"


def _sections(study: Comparison, store: Store) -> list[Section]:
    about = store.about()
    if not study.every:
        return [Section("summary", "Summary", [Text("The study holds no fits yet.")])]
    told = [
        *chapters(study, about),
        *adapting_chapters(study, about),
        *violation_chapters(study),
        *population_chapters(study),
    ]
    return [
        _summary(study, about, told),
        *(_chapter(study, about, chapter) for chapter in told),
        *appendix.posterior(study),
        *(timing(study, reference(study)) if study.scenarios else ()),
        appendix.failures(study),
        appendix.settings(study, store),
        appendix.origin(study, about),
        appendix.reading(),
    ]


def _summary(study: Comparison, about: Mapping[str, str], told: Sequence[Chapter]) -> Section:
    blocks: list[Block] = []
    if "mixed" in about:
        blocks.append(Text(f"**Careful: {appendix.mixed(about['mixed'])}**"))
    rules = rules_for(study.cells)
    if study.scenarios:
        blocks += _reference(study, about, rules)
    several = {n: c.key for c in told for n in c.tabled if not study.entry(n).one_recording}
    links = {**several, **links_of(study)}
    if len(links) > 1 or not study.scenarios:
        blocks.append(study_tables.matrix(study, _all_verdicts(study, rules, several), links))
        blocks.append(Text(f"{CODES}. {POPULATION_CODES}." if study.populations else f"{CODES}."))
    words = [
        *([rules.words] if study.scenarios else ()),
        *([POPULATION_RULES] if study.populations else ()),
    ]
    blocks.append(Text("Rules: " + " ".join(words)))
    return Section("summary", "Summary", blocks)


def _reference(study: Comparison, about: Mapping[str, str], rules: Rules) -> list[Block]:
    """What the methods do in the scenario that the summary is about."""
    name = reference(study)
    entry, cells = study.entry(name), study.of(name)
    power = ratio(about, name)
    share = f", remnant {100 * power:.0f} % of the control's power" if power == power else ""
    verdicts = [judge(cell, rules) for cell in cells]
    intro = f"Scenario `{name}` ({entry.description}{share}), {_recordings(study, name)}."
    if entry.one_recording:
        intro += " All fits are of one recording: bias and coverage say nothing of others."
    caption = f"`{name}`: all parameters in a row for each method"
    alt = f"Bias and rmse over the bound, and coverage, of each method in scenario {name}"
    return [
        Text(f"**{in_short(verdicts)}** {intro}"),
        study_tables.verdict_table(verdicts, caption),
        Bullets([sentence(v) for v in verdicts]),
        Picture.of(
            study_glance.glance(cells),
            "glance",
            alt,
            f"Scenario {name}, one point for each parameter, from the top down "
            f"{', '.join(p.parameter for p in entry.parameters)}. Bars: 95 % Monte Carlo "
            "intervals. Bias: linear within ±1, logarithmic beyond; grey: a quarter of the bound.",
        ),
    ]


def _all_verdicts(
    study: Comparison, rules: Rules, names: Mapping[str, str]
) -> dict[tuple[str, str], Entry]:
    verdicts = {
        (name, cell.method): judge(cell, rules) for name in names for cell in study.of(name)
    }
    entries = {place: Entry(v.code, v.grade.value) for place, v in verdicts.items()}
    return {**entries, **population_verdicts(study)}


def _chapter(study: Comparison, about: Mapping[str, str], chapter: Chapter) -> Section:
    full = [
        study_tables.scenario_table(study.of(name), chapter.paper.get(name, ()))
        for name in chapter.tabled
        if not study.entry(name).one_recording
    ]
    counts = _counts(study, chapter.scenarios)
    command = Command(
        "To reproduce:", appendix.command(study, about, chapter.scenarios, chapter.key)
    )
    blocks = [Text(f"{chapter.text} {counts}"), *chapter.blocks, *full, command]
    return Section(chapter.key, chapter.title, blocks)


def _counts(study: Comparison, scenarios: Sequence[str]) -> str:
    """How many recordings there are."""
    counts = sorted({study.replications([name]) for name in scenarios})
    if len(scenarios) == 1 and study.entry(scenarios[0]).one_recording:
        return f"{counts[0]} initial guesses."
    if len(scenarios) == 1:
        return f"{_recordings(study, scenarios[0])}."
    return f"{NONE.join(str(c) for c in sorted({counts[0], counts[-1]}))} recordings a scenario."
