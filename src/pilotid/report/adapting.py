"""The chapter on pilots who change: how well methods follow them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

from pilotid.numbers import NONE, number, plus_minus
from pilotid.report import adapting_figures as figures
from pilotid.report.chapters import Chapter
from pilotid.report.content import Block, Bullets, Column, Picture, Table, Text, entries
from pilotid.report.rules import ENOUGH, rules_for
from pilotid.report.tables import verdict_table
from pilotid.report.verdicts import judge
from pilotid.study.comparison import Cell, Comparison
from pilotid.study.entries import TRAJECTORY
from pilotid.study.tracks import TrackScore

KEY = "adapting"
#: A lag counts from this many seconds, a band holds from this share of the time, and errors
#: differ from this ratio.
LATE, HELD, WORSE = 1.0, 0.90, 2.0

TEXT = (
    "Not in the paper: the controlled element changes during the run, and the pilot with it (Zaal, "
    "JGCD 39(5) 2016). Gain and lead pass to other values; delay and neuromuscular system stay. "
    "Methods that know constant pilots alone do not apply. **Trajectories** are the parameters "
    "over time: errors are relative to the true value of the time, told before, during and after "
    "the change (from where a twentieth of it is done to where a twentieth is left, ten seconds at "
    "least), as root mean square over time and recordings. The **lag** is the shift in time at "
    "which the truth fits a trajectory best, median over recordings. **In band** is the share of "
    "the time at which the 95 % band holds the true value. `trajectories.csv` has all numbers."
)
RULES = (
    f"Rules: a method is **late** or **ahead** if the lag is certain (95 %) to exceed {LATE:g} s; "
    "its band **does not hold** a parameter if it is certain to hold the truth less than "
    f"{100 * HELD:.0f} % of the time; how many times as large as the least in the scenario its "
    f"error is, is said from {WORSE:g} on. Fewer than {ENOUGH} fits give no sentence."
)


def adapting_chapters(study: Comparison, about: Mapping[str, str]) -> list[Chapter]:
    """The chapter on pilots who change; nothing if the study has none."""
    names = tuple(name for name in study.names if f"{TRAJECTORY} {name}" in about)
    if not names:
        return []
    blocks: list[Block] = []
    for name in names:
        blocks += _scenario(study, name, json.loads(about[f"{TRAJECTORY} {name}"]))
    blocks.append(Text(RULES))
    return [Chapter(KEY, "Pilots who change", TEXT, names, blocks, names)]


def _scenario(study: Comparison, name: str, truth: Mapping[str, Sequence[float]]) -> list[Block]:
    """What the methods do in one scenario."""
    every = study.of(name)
    rules = rules_for(study.cells)
    verdicts = [judge(cell, rules) for cell in every if cell.tried]
    blocks: list[Block] = [
        Text(f"**`{name}`**: {study.entry(name).description}."),
        verdict_table(verdicts, f"`{name}`: the model's parameters"),
    ]
    cells = [cell for cell in every if cell.tracks]
    if not cells:
        return blocks
    words = [sentence for cell in cells if (sentence := _sentence(cell, cells))]
    if words:
        blocks.append(Bullets(words))
    blocks += [
        Picture.of(
            figures.paths(cells, truth),
            f"trajectories-{name}",
            f"Gain and lead over time by each method in scenario {name}, beside the truth",
            f"Scenario {name}: median (line) and range from 5 to 95 % (shaded) of the estimated "
            "trajectories, at each time; dashed: the truth.",
        ),
        _track_table(f"`{name}`: trajectories of what changes", cells, moving=True),
        _track_table(f"`{name}`: trajectories of what stays", cells, moving=False),
    ]
    return blocks


def _track_table(caption: str, cells: Sequence[Cell], *, moving: bool) -> Table:
    """A row for each parameter and method, of parameters that change or of those that stay."""
    columns = [
        Column("parameter", text=True),
        Column("method", text=True),
        Column("n", hint="trajectories"),
        Column("before %", hint="rms of relative errors with its Monte Carlo standard error"),
        Column("during %", hint="rms of relative errors with its Monte Carlo standard error"),
        Column("after %", hint="rms of relative errors with its Monte Carlo standard error"),
        Column("whole %", hint="rms of relative errors with its Monte Carlo standard error"),
        Column("median %", hint="of the recordings' root mean squares over the whole window"),
        Column("lag s", hint="median with its Monte Carlo standard error"),
        Column("in band %", hint="share of the time, with its Monte Carlo standard error"),
    ]
    rows = []
    for key in dict.fromkeys(s.parameter for cell in cells for s in cell.tracks):
        for cell in cells:
            s = next(s for s in cell.tracks if s.parameter == key)
            if math.isfinite(s.lag) != moving:
                continue
            errors = [
                plus_minus(100.0 * value, 100.0 * error).lstrip("+")
                for value, error in zip(s.rmse, s.rmse_se, strict=True)
            ]
            held = plus_minus(100.0 * s.coverage, 100.0 * s.coverage_se).lstrip("+")
            lag = plus_minus(s.lag, s.lag_se) if math.isfinite(s.lag) else NONE
            rows.append(
                [s.parameter, cell.method, str(s.n), *errors, number(100.0 * s.median), lag, held]
            )
    return Table(caption, columns, entries(rows), heads=2, folded=not moving)


def of_change(cell: Cell) -> list[TrackScore]:
    """Scores of the parameters that change."""
    return [s for s in cell.tracks if math.isfinite(s.lag)]


def _sentence(cell: Cell, cells: Sequence[Cell]) -> str:
    """What a method can and cannot do with a pilot who changes, by `RULES`."""
    own = of_change(cell)
    if not own or min(s.n for s in own) < ENOUGH:
        return ""
    parts = []
    for s in own:
        least = min(
            other.rmse[3] for c in cells for other in of_change(c) if other.parameter == s.parameter
        )
        ratio = s.rmse[3] / least
        words = f"{s.parameter} off by {number(100.0 * s.rmse[3], 2)} %"
        if ratio >= WORSE:
            words += f" ({number(ratio, 2)} times the least)"
        parts.append(words)
    late = [s for s in own if abs(s.lag) - 1.96 * s.lag_se > LATE]
    narrow = [s for s in cell.tracks if s.coverage + 1.96 * s.coverage_se < HELD]
    said = [" and ".join(parts)]
    if late:
        lags = " and ".join(
            f"{s.parameter} {number(abs(s.lag), 2)} s {'late' if s.lag > 0 else 'ahead'}"
            for s in late
        )
        said.append(lags)
    else:
        said.append("neither late nor ahead")
    if narrow:
        keys = ", ".join(f"{s.parameter} ({100.0 * s.coverage:.0f} %)" for s in narrow)
        said.append(f"its band does not hold {keys}")
    else:
        said.append("its bands hold")
    return f"`{cell.method}`: {'; '.join(said)}."
