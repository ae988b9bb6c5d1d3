"""Runs left out: methods and models ranked on recordings of people, as a file and as a table."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pilotid.analysis.analyse import group_of
from pilotid.analysis.cross_validation import (
    COLUMNS,
    LeftOut,
    Standing,
    left_out_rows,
    rank_methods,
)
from pilotid.analysis.recordings import Part
from pilotid.analysis.rows import grouped
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


def _texts(held: dict[object, object]) -> dict[str, str]:
    return {str(name): str(value) for name, value in held.items()}


def read_board(path: Path) -> Board:
    """The board of a file that `Board.to_dict` went to.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        lines: list[LeftOut] = []
        for own in held["runs_left_out"]:
            part = Part((Path(own["file"]),), tuple(_texts(own["fields"]).items()))
            content = {"model": str(own["model"]), "left_out": [own]}
            lines += left_out_rows(part, int(own["run"]), content)
        ratios = {
            (str(file), str(model), str(method)): [math.nan if r is None else float(r) for r in own]
            for file, model, method, own in held["runs_over_claims"]
        }
        return Board(lines, ratios, str(held["command"]), _texts(held["versions"]))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: cannot be read as what `pilotid analyse --left-out` wrote; make it again"
        ) from error


def group_words(group: Sequence[tuple[str, str]]) -> str:
    """A group of recordings, or the stratum of a contrast, in words."""
    fields = [value for field, value in group if field != "file"]
    return " ".join(fields) or " ".join(stem_of(value) for _, value in group)


def _is_best(behind: float, error: float) -> bool:
    return behind == 0.0 and not math.isfinite(error)


def left_out_blocks(board: Board) -> list[Block]:
    """What runs left out are, and models and methods by them, within each kind of recording."""

    def behind(value: float, error: float) -> str:
        return "best" if _is_best(value, error) else plus_minus(value, error)

    def best(row: tuple[str, Standing, float]) -> str:
        return "good" if _is_best(*row[1].behind) else ""

    columns: list[Column[tuple[str, Standing, float]]] = [
        Column("recordings", lambda r: r[0]),
        Column("model", lambda r: r[1].model),
        Column("method", lambda r: r[1].method),
        Column("runs", lambda r: r[1].runs, str, "left out of a fit"),
        Column("failed", lambda r: r[1].failed, str, "fits of the others that do not count"),
        Column("VAF %", lambda r: r[1].vaf, unsigned, "of runs left out"),
        Column(
            "likelihood", lambda r: r[1].behind, behind, "of a run left out, less the best", best
        ),
        Column("runs / claims", lambda r: (r[2], 2), number, "scatter over claimed errors"),
    ]
    rows = []
    for group, own in grouped(board.lines, lambda each: group_of(each.part)).items():
        files = dict.fromkeys(each.part.name for each in own)
        for s in rank_methods(own):
            held = [board.ratios.get((file, s.model, s.method), ()) for file in files]
            known = [ratio for ratios in held for ratio in ratios if math.isfinite(ratio)]
            rows.append((group_words(group), s, float(np.median(known)) if known else math.nan))
    caption = "Runs predicted by the fit of the others, the likeliest first"
    filters = (0, 1, 2) if len(rows) > 12 else ()
    return [Text(TEXT), Table(caption, columns, rows, heads=2, filters=filters)]
