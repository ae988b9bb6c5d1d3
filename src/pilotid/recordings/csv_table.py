"""The cells of a CSV file: what is needed becomes numbers, a block of rows at a time."""

from __future__ import annotations

import csv
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import TextIO

import numpy as np

from pilotid.recordings.csv_text import (
    LONGEST_ROW,
    layout_of,
    too_long,
    unit_of,
    unknown_encoding,
)
from pilotid.recordings.names import MOST_VALUES, bare, listed, shown
from pilotid.types import FloatArray, InputError

RUN = "run"  # the column that numbers the runs of a file in long format
LONGEST_LABEL = 100  # characters of a run's number or name
MOST_LABELS = 10_000
MOST_BLANKS = 2**20  # lines at the end: as many as a spreadsheet has
CELLS = 2**18  # that are turned into numbers at once


class Table:
    """A file by rows: what is needed of it becomes numbers, the rest is not kept."""

    def __init__(self, stream: TextIO, source: str) -> None:
        self.source = source
        self._stream = stream
        self.line = 1
        self._in_row = 0  # characters read since the last row was complete
        self._reader = csv.reader([""])
        layout = layout_of(self._lines(), source)
        self.line = layout.line  # of the header
        self._separator = layout.separator
        self._reader = csv.reader(
            self._stripped(chain(layout.lines, self._lines())),
            delimiter=self._separator,
            skipinitialspace=True,
            strict=True,
        )
        row = next((rows[0] for _, rows in self._blocks(1) if rows), [])
        self.header = [name.strip() for name in row]
        if not any(self.header):
            raise InputError(
                f"{source}: line {self.line} must be a header row with the columns t, e, u, x"
            )
        self._under: dict[str, str] = {}  # the units in a row under the header
        self._decimal = ""  # the sign between whole and part, once a cell has one
        self._count = Counter(self.header)
        self.lines = array("Q")  # on which each row starts: a quoted cell may hold line breaks
        self.labels: dict[str, array[int]] = {}  # rows of each run of the long format
        self._blank: tuple[int, list[str]] | None = None  # the first row without content
        self._blanks = 0

    def _lines(self) -> Iterator[str]:
        try:
            for line in self._stream:
                self._in_row += len(line)
                if self._in_row > LONGEST_ROW:
                    raise too_long(self.source, self._at + 1)
                yield line
        except UnicodeError:
            raise unknown_encoding(self.source, self._at + 1) from None

    def _stripped(self, lines: Iterable[str]) -> Iterator[str]:
        """The lines as the reader of cells wants them: no spaces at the ends that separate none."""
        return (f"{line.strip()}\n" for line in lines) if self._separator == " " else iter(lines)

    @property
    def _at(self) -> int:
        """The number of the line that was read last."""
        return self._reader.line_num + self.line - 1

    def unit(self, column: str) -> str | None:
        """The unit of a column, in its name or in the row below the header; None if unsaid."""
        return bare(column)[1] or self._under.get(column)

    def _blocks(self, size: int) -> Iterator[tuple[list[int], list[list[str]]]]:
        """The lines on which rows start, and their cells, some rows at once."""
        line = self._at + 1
        starts: list[int] = []
        rows: list[list[str]] = []
        try:
            for row in self._reader:
                starts.append(line)
                rows.append(row)
                line = self._at + 1
                self._in_row = 0
                if len(rows) >= size:
                    yield starts, rows
                    starts, rows = [], []
        except csv.Error as error:
            yield starts, rows
            raise InputError(
                f"{self.source}: line {line} cannot be read as comma-separated values ({error}); "
                "correct it"
            ) from None
        yield starts, rows

    def read(self, names: Sequence[str]) -> FloatArray:
        """Some columns as finite numbers, shape (rows, columns)."""
        for name in [*names, RUN]:
            if self._count[name] > 1:
                raise InputError(
                    f"{self.source}: line {self.line} has more than one column {shown(name)}; "
                    "rename all but one"
                )
        index = {name: i for i, name in enumerate(self.header)}
        places = [index[name] for name in names]
        pieces: list[FloatArray] = []
        for starts, rows in self._below_units(names, places):
            if self._blank or not self._plain(rows):
                starts, rows = self._filled(starts, rows, names)
            self.lines.extend(starts)
            if len(self.lines) > MOST_VALUES // len(names):
                raise InputError(
                    f"{self.source}: holds more than {MOST_VALUES} values, too many for a "
                    "recording; thin it out in time or leave runs out"
                )
            cells = [row[i] for row in rows for i in places]
            pieces.append(self._numbers(cells, starts, names))
            if RUN in index:
                self._label([row[index[RUN]].strip() for row in rows])
        return np.concatenate(pieces)

    def _below_units(
        self, names: Sequence[str], places: Sequence[int]
    ) -> Iterator[tuple[list[int], list[list[str]]]]:
        """The blocks of rows, without a row of units at their beginning."""
        blocks = self._blocks(max(1, CELLS // len(self.header)))
        starts, rows = next(blocks)
        if rows and len(rows[0]) == len(self.header):
            cells = [rows[0][i] for i in places]
            units = [unit for cell in cells if (unit := unit_of(cell)) is not None]
            if len(units) == len(cells) and any(units):
                self._under = dict(zip(names, units, strict=True))
                starts, rows = starts[1:], rows[1:]
        yield starts, rows
        yield from blocks

    def _plain(self, rows: list[list[str]]) -> bool:
        """Whether rows may all have content: the last one tells, as what follows must be blank."""
        return not rows or (
            {*map(len, rows)} == {len(self.header)} and any(map(str.strip, rows[-1]))
        )

    def _filled(
        self, starts: list[int], rows: list[list[str]], names: Sequence[str]
    ) -> tuple[list[int], list[list[str]]]:
        """The rows with content; those without are allowed at the end only."""
        kept: list[int] = []
        for i, row in enumerate(rows):
            if any(map(str.strip, row)):
                for line, cells in [self._blank or (starts[i], row), (starts[i], row)]:
                    if len(cells) != len(self.header):
                        remedy = "complete or remove that line"
                        if self._separator == "," and len(cells) > len(self.header) + 1:
                            remedy += ", or separate cells by semicolons if decimals have commas"
                        raise InputError(
                            f"{self.source}: line {line} has {len(cells)} cells but the header has "
                            f"{len(self.header)}; {remedy}"
                        )
                if self._blank:
                    raise self._not_a_number("", self._blank[0], names[0])
                kept.append(i)
                continue
            self._blank = self._blank or (starts[i], row)
            self._blanks += 1
            if self._blanks > MOST_BLANKS:
                raise InputError(
                    f"{self.source}: more than {MOST_BLANKS} blank lines follow line "
                    f"{self._blank[0]}; remove them"
                )
        return [starts[i] for i in kept], [rows[i] for i in kept]

    def _label(self, labels: Sequence[str]) -> None:
        """Note the runs of the last rows."""
        for row, label in enumerate(labels, start=len(self.lines) - len(labels)):
            if not label or len(label) > LONGEST_LABEL:
                what = "has a text too long for it" if label else "is empty"
                raise InputError(
                    f"{self.source}: line {self.lines[row]}, column {RUN}: the cell {what}; write "
                    "the number of the run"
                )
            self.labels.setdefault(label, array("q")).append(row)
        if len(self.labels) > MOST_LABELS:
            raise InputError(
                f"{self.source}: column {RUN} numbers more than {MOST_LABELS} runs; rename it if "
                "it is no number of the run"
            )

    def _numbers(self, cells: list[str], starts: list[int], names: Sequence[str]) -> FloatArray:
        """Some rows of cells as finite numbers."""
        signs = "".join(cells)
        commas, points = signs.count(","), signs.count(".")
        self._decimal = self._decimal or ("," if commas > points else "." if points else "")
        wrong = {",": ".", ".": ","}.get(self._decimal, "")
        if wrong and wrong in signs:
            first = next(i for i, cell in enumerate(cells) if wrong in cell)
            row, column = divmod(first, len(names))
            raise self._not_a_number(cells[first].strip(), starts[row], names[column])
        if self._decimal == ",":
            cells = [cell.replace(",", ".") for cell in cells]
        try:
            values = np.array(list(map(float, cells)))
            plain = "_" not in signs
        except ValueError:
            plain = False
        if not plain:
            values = np.array([number_or_nan(cell) for cell in cells])
        bad = ~np.isfinite(values)
        if bad.any():
            first = int(np.argmax(bad))
            row, column = divmod(first, len(names))
            raise self._not_a_number(cells[first].strip(), starts[row], names[column])
        return values.reshape(len(starts), len(names))

    def _not_a_number(self, text: str, line: int, name: str) -> InputError:
        what = f"{shown(text)} is not a finite number" if text else "the cell is empty"
        remedy = "repair or cut the recording there"
        if "." in text if self._decimal == "," else "," in text:
            remedy = f"write a decimal {'comma' if self._decimal == ',' else 'point'}"
        return InputError(f"{self.source}: line {line}, column {listed([name])}: {what}; {remedy}")

    def where(self, rows: Sequence[int]) -> Callable[[int], str]:
        """A function that puts the place of the i-th of some rows into words."""
        return lambda i: f"line {self.lines[rows[i]]}"


def number_or_nan(cell: str) -> float:
    """A cell as a number, NaN if it is none; Python's 1_000 is none."""
    try:
        return np.nan if "_" in cell else float(cell)
    except ValueError:
        return np.nan
