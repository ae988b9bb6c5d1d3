"""The cells of a CSV file: what is needed becomes numbers, a block of rows at a time."""

from __future__ import annotations

import csv
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import TextIO

import numpy as np

from pilotid.recordings.names import MOST_VALUES, listed, shown
from pilotid.types import FloatArray, InputError

RUN = "run"  # the column that numbers the runs of a file in long format
LONGEST_ROW = 2**22  # characters: the length of a row is the memory that it takes
LONGEST_LABEL = 100  # characters of a run's number or name
MOST_LABELS = 10_000
MOST_BLANKS = 2**20  # lines at the end: as many as a spreadsheet has
CELLS = 2**18  # that are turned into numbers at once


class Table:
    """A file by rows: what is needed of it becomes numbers, the rest is not kept."""

    def __init__(self, stream: TextIO, source: str) -> None:
        self.source = source
        self._stream = stream
        self._in_row = 0  # characters read since the last row was complete
        self._reader = csv.reader([""])
        first = next(self._lines(), "")
        # Spreadsheets in countries with a decimal comma separate the cells by semicolons.
        separator = ";" if ";" in first and "," not in first else ","
        self._reader = csv.reader(
            chain([first], self._lines()), delimiter=separator, skipinitialspace=True, strict=True
        )
        row = next((rows[0] for _, rows in self._blocks(1) if rows), [])
        self.header = [name.strip() for name in row]
        if not any(self.header):
            raise InputError(f"{source}: line 1 must be a header row with the columns t, e, u, x")
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
                    raise _too_long(self.source, self._reader.line_num + 1)
                yield line
        except UnicodeDecodeError as error:
            number = self._reader.line_num + 1 + error.object.count(b"\n", 0, error.start)
            raise InputError(
                f"{self.source}: line {number} is not UTF-8 text; save the file as CSV in UTF-8"
            ) from None

    def _blocks(self, size: int) -> Iterator[tuple[list[int], list[list[str]]]]:
        """The lines on which rows start, and their cells, some rows at once."""
        line = self._reader.line_num + 1
        starts: list[int] = []
        rows: list[list[str]] = []
        try:
            for row in self._reader:
                starts.append(line)
                rows.append(row)
                line = self._reader.line_num + 1
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
                    f"{self.source}: line 1 has more than one column {shown(name)}; rename all "
                    "but one"
                )
        index = {name: i for i, name in enumerate(self.header)}
        places = [index[name] for name in names]
        pieces: list[FloatArray] = []
        for starts, rows in self._blocks(max(1, CELLS // len(self.header))):
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
                        raise InputError(
                            f"{self.source}: line {line} has {len(cells)} cells but the header has "
                            f"{len(self.header)}; complete or remove that line"
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
        try:
            values = np.array(list(map(float, cells)))
            plain = "_" not in "".join(cells)
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
        remedy = "write a decimal point" if "," in text else "repair or cut the recording there"
        return InputError(f"{self.source}: line {line}, column {listed([name])}: {what}; {remedy}")

    def where(self, rows: Sequence[int]) -> Callable[[int], str]:
        """A function that puts the place of the i-th of some rows into words."""
        return lambda i: f"line {self.lines[rows[i]]}"


def _too_long(source: str, line: int) -> InputError:
    return InputError(
        f"{source}: line {line} is longer than {LONGEST_ROW} characters; give every sample a line "
        "of its own"
    )


def check_lines(path: Path, source: str) -> None:
    """Refuse a line that would fill the memory before it can be looked at."""
    ended, line = 0, 1  # bytes before the present line, and its number
    with path.open("rb") as stream:
        at = 0
        while block := stream.read(LONGEST_ROW):
            last = max(block.rfind(b"\n"), block.rfind(b"\r"))
            if last < 0 and at + len(block) - ended > LONGEST_ROW:
                raise _too_long(source, line)
            if last >= 0:
                line += block.count(b"\n") or block.count(b"\r")
                ended = at + last + 1
            at += len(block)


def number_or_nan(cell: str) -> float:
    """A cell as a number, NaN if it is none; Python's 1_000 is none."""
    try:
        return np.nan if "_" in cell else float(cell)
    except ValueError:
        return np.nan
