"""Runs left out as a file that says all that pages over several studies show of an analysis."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pilotid.analysis.cross_validation import COLUMNS, LeftOut, left_out_rows
from pilotid.analysis.recordings import Part
from pilotid.types import InputError

#: The file, in the folder of an analysis.
BOARD = "left_out.json"


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
        return {"command": self.command, "versions": dict(self.versions), "runs_left_out": lines,
                "runs_over_claims": ratios}  # fmt: skip


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
