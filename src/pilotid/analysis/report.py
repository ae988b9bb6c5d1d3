"""The report of an analysis: summary, models, estimates, contrasts, runs, recordings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from pilotid.analysis.analyse import PAGES, Analysis, group_of
from pilotid.analysis.report_estimates import (
    LEVEL,
    chance,
    conditions,
    estimates,
    group_words,
    runs,
)
from pilotid.analysis.report_left_out import left_out_blocks
from pilotid.analysis.results import Results
from pilotid.analysis.rows import SUBJECT
from pilotid.analysis.spread import ConditionSpread, spread_sentence
from pilotid.disk import write_file
from pilotid.numbers import NONE, number
from pilotid.report.content import (
    Block,
    Bullets,
    Column,
    Command,
    Entry,
    Section,
    Table,
    Text,
    entries,
    web_page,
    write_pictures,
)
from pilotid.report.trust import trust_blocks
from pilotid.study.trust import UNKNOWN
from pilotid.time_domain.constancy import LEVEL as CHANGES

TITLE = "Pilot models of recorded subjects"


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
    sections = [
        _summary(results),
        _models(results),
        *estimates(results),
        *conditions(results),
        *runs(results),
        *_tried(results, folder),
        *_left_out(results, command, about),
        _recordings(results.analysis),
        _origin(results, command, about),
    ]
    write_pictures(folder, sections)
    _clear(folder, results.analysis)
    path = folder / "report.html"
    write_file(path, web_page(TITLE, sections).encode("utf-8", "replace"))
    return path


def _clear(folder: Path, analysis: Analysis) -> None:
    """Remove pages of recordings that an earlier call made and this report does not name."""
    named = {folder / page for fit in analysis.fits if (page := fit.content.get("page"))}
    for path in (folder / PAGES).glob("*_??????.html"):
        if path not in named:
            path.unlink(missing_ok=True)


def _summary(results: Results) -> Section:
    analysis = results.analysis
    subjects = {dict(part.fields).get(SUBJECT) for part in analysis.parts} - {None}
    runs = sum(int(look["recording"]["runs"]) for look in analysis.looks.values())
    of = f" of {len(subjects)} subjects" if subjects else ""
    told = [f"{len(analysis.parts)} recordings{of}, {runs} runs."]
    items: list[str] = []
    if results.chosen is not None:
        chosen: dict[str, list[str]] = {}
        for group, choice in analysis.choices.items():
            chosen.setdefault(choice.model, []).append(group_words(group) or "all")
        items += [f"Model `{model}`: {'; '.join(where)}." for model, where in chosen.items()]
    clear = [c for c in results.contrasts if c.p_holm < LEVEL]
    if results.contrasts:
        items.append(
            f"{len(clear)} of {len(results.contrasts)} {_compared(results)} have p < "
            f"{LEVEL:g} after Holm's correction"
            + (": see [conditions](#conditions)." if clear else ".")
        )
    told_of = [s for s in map(spread_sentence, _by_condition(results)) if s]
    items += [f"{s[0].upper()}{s[1:]}." for s in told_of]
    items += _changing(analysis)
    failed = [
        f"{fit.part.words}: `{e['method']}` {e['verdict'].partition(': ')[2]}"
        for fit in analysis.fits
        if fit.run is None
        for e in fit.content["estimates"]
        if e["outcome"] != "converged"
    ]
    if failed:
        items.append(f"Not converged, or at a bound: {'; '.join(failed)}.")
    remarked = sum(bool(look["remarks"]) for look in analysis.looks.values())
    if remarked:
        items.append(f"{remarked} recordings have remarks: see [recordings](#recordings).")
    items += results.notes
    blocks: list[Block] = [Text(" ".join(told)), Bullets(items)]
    if analysis.refused:
        blocks += [Text("**Left out:**"), Bullets(list(analysis.refused))]
    return Section("summary", "Summary", blocks)


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
        f"(p < {CHANGES:g} of a constant pilot): {', '.join(where)}. `adapting` is a model of such "
        "pilots."
    ]


def _models(results: Results) -> Section:
    analysis = results.analysis
    items = [
        f"**{group_words(group)}** {choice.reason.replace('+-', '±')}"
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
    left = {n: sum(sum(own[n].left_out_chi_squared) for own in held) for n in names}
    aicc = {n: sum(own[n].aicc for own in held) for n in names}
    bic = {n: sum(own[n].bic for own in held) for n in names}
    for name in sorted(names, key=lambda n: left[n] or aicc[n]):
        own = [candidates[name] for candidates in held]
        mark = "good" if name == analysis.choices[tuple(group)].model else ""
        yield [
            Entry(group_words(group)),
            Entry(name, mark),
            Entry(str(own[0].pilot_parameters)),
            Entry(number(sum(c.chi_squared for c in own) / max(sum(c.freedom for c in own), 1))),
            Entry(number(left[name] - min(left.values())) if left[name] else NONE),
            Entry(number(aicc[name] - min(aicc.values()))),
            Entry(number(bic[name] - min(bic.values()))),
            Entry(number(sum(c.vaf for c in own) / len(own))),
            Entry(number(sum(c.left_out_vaf for c in own) / len(own))),
        ]


def _by_condition(results: Results) -> list[list[ConditionSpread]]:
    groups: dict[tuple[object, ...], list[ConditionSpread]] = {}
    for spread in results.by_condition:
        key = (spread.stratum, spread.condition, spread.model, spread.method)
        groups.setdefault(key, []).append(spread)
    return list(groups.values())


def _recordings(analysis: Analysis) -> Section:
    columns = [
        Column("recording", text=True),
        Column("model", text=True),
        Column("method", text=True),
        Column("runs"),
        Column("VAF %"),
        Column("p constant", hint="chance that a constant pilot seems to change as this one"),
        Column("by %", hint="how much a gain or lead changes at most"),
        Column("at s", hint="when that change is seen best, from the start of the window"),
        Column("outcome", text=True),
        Column("remarks", text=True),
    ]
    rows: list[list[str]] = []
    for fit in analysis.fits:
        if fit.run is not None:
            continue
        look = analysis.looks[fit.part]
        page = fit.content.get("page")
        name = f"[{fit.part.words}]({page})" if page else fit.part.words
        own = {c.model: c for c in analysis.candidates(fit.part)}.get(fit.content["model"])
        for place, e in enumerate(fit.content["estimates"]):
            told = [*(look["remarks"] if not place else ()), *e["remarks"]]
            rows.append(
                [
                    name,
                    fit.content["model"],
                    e["method"],
                    str(look["recording"]["runs"]),
                    number(math.nan if e["vaf"] is None else e["vaf"]),
                    chance(own.change_p) if own else NONE,
                    number(100.0 * own.change_size) if own else NONE,
                    number(own.change_time) if own and own.change_p < CHANGES else NONE,
                    e["outcome"],
                    "; ".join(told) or NONE,
                ]
            )
    caption = "Every recording, all runs together; the names lead to pages with figures"
    return Section("recordings", "Recordings", [Table(caption, columns, entries(rows))])


def _tried(results: Results, folder: Path) -> Iterator[Section]:
    """What simulations say of the fits; nothing where that was not asked for."""
    if results.tried:
        blocks: list[Block] = []
        for own in results.tried:
            page = (own.folder / "report.html").relative_to(folder).as_posix()
            blocks += [Text(f"**{own.words}**: [all methods]({page})")]
            blocks += trust_blocks(own.trust.to_dict())
        yield Section("trust", "What the fits are worth", [*blocks, Text(UNKNOWN)])


def _left_out(results: Results, command: str, about: Mapping[str, str]) -> Iterator[Section]:
    """Runs left out; nothing where that was not asked for."""
    if results.analysis.left_out:
        board = results.board(command, about)
        yield Section("left-out", "Runs left out", left_out_blocks(board))


def _origin(results: Results, command: str, about: Mapping[str, str]) -> Section:
    versions = ", ".join(f"{name} {version}" for name, version in about.items())
    return Section(
        "origin",
        "How this was made",
        [Command("To make it again:", command), Text(f"Versions: {versions}.")],
    )
