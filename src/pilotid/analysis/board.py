"""Runs left out: methods and models ranked on recordings of people, as a file and as a table."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pilotid.analysis.analyse import Group, group_of
from pilotid.analysis.cross_validation import (
    COLUMNS,
    LeftOut,
    Standing,
    left_out_rows,
    rank_methods,
)
from pilotid.analysis.recordings import Part
from pilotid.document import Block, Column, Table, Text
from pilotid.numbers import number, plus_minus, unsigned
from pilotid.recordings.selection import stem_of
from pilotid.types import InputError

#: The file, in the folder of an analysis.
BOARD = "left_out.json"


TEXT = (
    "No truth is known of people: what judges here is the run that a fit has not seen. Every run "
    "is predicted by the fit of the other runs of its recording. **VAF**: of its control, as "
    "the simulated response explains it. **Likelihood**: of its whitened prediction errors (nats a "
    "run), less that of the best of the same recordings, run by run; the remnant's model is chosen "
    "the same way for all, from what each leaves of the other runs. It is of all the control: the "
    "inverse of the controlled element predicts that well and is no pilot, which the VAF shows. "
    "**Runs / claims** is the agreement between runs: how many times as much as claimed the "
    "estimates of single runs differ, the median over parameters and recordings (--per-run). "
    "After ± stands the standard error over the runs; runs of one subject are alike, so that it "
    "is too small for other subjects."
)


@dataclass(frozen=True, eq=False)
class Board:
    """Runs left out, and what else pages need to rank methods on recordings of people.

    Attributes
    ----------
    lines
        The runs.
    ratios
        How many times as much as claimed single runs differ, by parameter, for each file,
        model and method; empty where runs were not fitted one by one.
    command, versions
        How they were made.
    """

    lines: Sequence[LeftOut]
    ratios: Mapping[tuple[str, str, str], Sequence[float]]
    command: str
    versions: Mapping[str, str]

    def to_dict(self) -> dict[str, object]:
        """Plain objects, with files by their names alone: where they are is nobody's business."""
        lines = [
            {
                "file": Path(e.part.name).name,
                "fields": dict(e.part.fields),
                "usable": e.usable,
                **dict(zip(COLUMNS, e.cells, strict=True)),
            }
            for e in self.lines
        ]
        ratios = [[Path(file).name, *rest, list(own)] for (file, *rest), own in self.ratios.items()]
        return {
            "command": self.command,
            "versions": dict(self.versions),
            "runs_left_out": lines,
            "runs_over_claims": ratios,
        }


def read_board(path: Path) -> Board:
    """The board of a file that `Board.to_dict` went to.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        lines = [
            line
            for own in held["runs_left_out"]
            for line in left_out_rows(
                Part(
                    (Path(own["file"]),), tuple((str(k), str(v)) for k, v in own["fields"].items())
                ),
                int(own["run"]),
                {"model": str(own["model"]), "left_out": [own]},
            )
        ]
        ratios = {
            (str(file), str(model), str(method)): [math.nan if r is None else float(r) for r in own]
            for file, model, method, own in held["runs_over_claims"]
        }
        return Board(lines, ratios, str(held["command"]), _texts(held["versions"]))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: cannot be read as what `pilotid analyse --left-out` wrote; make it again"
        ) from error


def _texts(held: Mapping[Any, Any]) -> dict[str, str]:
    return {str(name): str(value) for name, value in held.items()}


def group_words(group: Sequence[tuple[str, str]]) -> str:
    """A group of recordings, or the stratum of a contrast, in words."""
    fields = [value for field, value in group if field != "file"]
    return " ".join(fields) or " ".join(stem_of(value) for _, value in group)


class Ranked(NamedTuple):
    """A model and a method on recordings of one kind."""

    kind: str
    standing: Standing
    ratio: float

    @property
    def vaf(self) -> tuple[float, float]:
        """Mean over the runs [%], and its standard error."""
        return self.standing.vaf, self.standing.vaf_error

    @property
    def behind(self) -> tuple[float, float]:
        """Log-likelihood less that of the best, and its standard error."""
        return self.standing.behind, self.standing.behind_error


def _is_best(behind: float, error: float) -> bool:
    return behind == 0.0 and not math.isfinite(error)


def left_out_blocks(board: Board) -> list[Block]:
    """What runs left out are, and models and methods by them, within each kind of recording."""

    def behind(value: float, error: float) -> str:
        return "best" if _is_best(value, error) else plus_minus(value, error)

    def best(row: Ranked) -> str:
        return "good" if _is_best(*row.behind) else ""

    columns: list[Column[Ranked]] = [
        Column("recordings", lambda r: r.kind),
        Column("model", lambda r: r.standing.model),
        Column("method", lambda r: r.standing.method),
        Column("runs", lambda r: r.standing.runs, str, "left out of a fit"),
        Column("failed", lambda r: r.standing.failed, str, "fits of the others that do not count"),
        Column("VAF %", lambda r: r.vaf, unsigned, "of runs left out"),
        Column("likelihood", lambda r: r.behind, behind, "of a run left out, less the best", best),
        Column("runs / claims", lambda r: (r.ratio, 2), number, "scatter over claimed errors"),
    ]
    groups: dict[Group, list[LeftOut]] = {}
    for each in board.lines:
        groups.setdefault(group_of(each.part), []).append(each)
    rows = []
    for group, own in groups.items():
        files = {each.part.name for each in own}
        for s in rank_methods(own):
            ratios = [
                ratio
                for (file, *what), found in board.ratios.items()
                if file in files and what == [s.model, s.method]
                for ratio in found
                if math.isfinite(ratio)
            ]
            rows.append(
                Ranked(group_words(group), s, float(np.median(ratios)) if ratios else math.nan)
            )
    caption = "Runs predicted by the fit of the others, the likeliest first"
    filters = (0, 1, 2) if len(rows) > 12 else ()
    return [Text(TEXT), Table(caption, columns, rows, heads=2, filters=filters)]
