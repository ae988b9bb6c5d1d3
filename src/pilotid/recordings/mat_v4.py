"""Variables of MATLAB v4 files: full real matrices and texts one behind the other.

Source: "MAT-File Format", The MathWorks; level 4.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from pilotid.recordings.mat_variables import (
    LONGEST_TEXT,
    Chosen,
    DamagedError,
    Value,
    Variables,
)
from pilotid.types import InputError

HEADER = 20  # bytes: kind, rows, columns, whether complex, length of the name
NUMBERS = ("f8", "f4", "i4", "i2", "u2", "u1")
FULL, TEXT = 0, 1
LONGEST_NAME = 64


def looks_like_v4(head: bytes) -> bool:
    """Whether the first bytes of a file are the header of a v4 matrix."""
    return _header(head) is not None


def _header(head: bytes) -> tuple[str, int, int, int, int, int, int] | None:
    """Byte order, kind of numbers, kind of matrix, rows, columns, complex, length of the name."""
    if len(head) < HEADER:
        return None
    for order in "<>":
        kind, rows, columns, imaginary, length = struct.unpack(f"{order}5i", head[:HEADER])
        machine, rest = divmod(kind, 1000)
        zero, rest = divmod(rest, 100)
        numbers, matrix = divmod(rest, 10)
        if (
            machine == "<>".index(order)
            and zero == 0
            and numbers < len(NUMBERS)
            and matrix < 3
            and imaginary in (0, 1)
            and min(rows, columns) >= 0
            and 1 < length <= LONGEST_NAME
        ):
            return order, numbers, matrix, rows, columns, imaginary, length
    return None


class MatV4(Variables):
    """A MATLAB v4 file."""

    def walked(self, wanted: Chosen, entered: Chosen) -> Iterator[tuple[str, Value]]:
        size = self._path.stat().st_size
        with self._path.open("rb") as file:
            while (start := file.tell()) < size:
                try:
                    yield from self._matrix(file, size, wanted)
                except DamagedError as error:
                    raise InputError(
                        f"{self._source}: the MATLAB v4 file is damaged or cut short ({error}, in "
                        f"the variable at byte {start}); save it again with save -v7"
                    ) from None

    def _matrix(self, file: BinaryIO, size: int, wanted: Chosen) -> Iterator[tuple[str, Value]]:
        self._budget.look()
        header = _header(file.read(HEADER))
        if header is None:
            raise DamagedError("it has no header")
        order, numbers, matrix, rows, columns, imaginary, length = header
        name = file.read(length).partition(b"\0")[0].decode("ascii", "backslashreplace")
        dtype = np.dtype(f"{order}{NUMBERS[numbers]}")
        count = rows * columns
        end = file.tell() + count * dtype.itemsize * (1 + imaginary)
        if not name or end > size:
            raise DamagedError("the end comes too early")
        value: Value = None
        if wanted(name) and matrix in (FULL, TEXT) and not imaginary:
            self._budget.read(count)
            values = np.frombuffer(file.read(count * dtype.itemsize), dtype)
            if matrix == FULL:
                value = values.reshape((rows, columns), order="F").squeeze()
            elif rows == 1 and count <= LONGEST_TEXT:
                value = bytes(values.astype(np.uint8)).decode("latin-1")
        file.seek(end)
        yield name, value
