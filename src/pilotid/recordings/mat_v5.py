"""Variables of MATLAB v5 files, read within limits on everything that a file can claim.

Own code because the usual reader, `scipy.io.loadmat`, trusts what a file says: one changed byte
can end the process, and megabytes can fill the memory.  A recording needs little of the format:
full real arrays and texts, also inside structs and cells.  All else is skipped by its size and
never read.

Source: "MAT-File Format", The MathWorks; level 5.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pilotid.recordings.mat_elements import COMPRESSED, MATRIX, Bytes, Unpacked
from pilotid.recordings.mat_variables import (
    DEEPEST,
    LONGEST_TEXT,
    MOST_ARRAYS,
    Chosen,
    DamagedError,
    Value,
    Variables,
)
from pilotid.types import InputError

FILE_HEADER = 128  # bytes before the first variable
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
NUMBERS |= {12: "i8", 13: "u8"}
TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
# Kinds of numbers of the numeric classes; MATLAB stores them as smaller integers where it can.
CLASS_KINDS = (9, 7, 1, 2, 3, 4, 5, 6, 12, 13)
CELL, STRUCT, TEXT, NUMERIC, OPAQUE = 1, 2, 4, range(6, 16), 17  # classes of arrays
COMPLEX = 0x800

LONGEST_NAME = 4096
MOST_DIMENSIONS = 32


@dataclass(frozen=True)
class _Head:
    """What an array says of itself before its content."""

    name: str
    array_class: int
    shape: tuple[int, ...]
    is_complex: bool

    @property
    def holds_arrays(self) -> bool:
        """Whether it consists of arrays: structs, and cells."""
        return self.array_class in (CELL, STRUCT)

    @property
    def members(self) -> list[str]:
        """What to write behind the name of each of its members; nothing for a single struct."""
        count = math.prod(self.shape)
        if count > MOST_ARRAYS:
            raise DamagedError(f"more than {MOST_ARRAYS} variables")
        if self.array_class == CELL:
            return [f"{{{i + 1}}}" for i in range(count)]
        return [""] if count == 1 else [f"({i + 1})" for i in range(count)]


class MatV5(Variables):
    """A MATLAB v5 file.

    Parameters
    ----------
    path
        The file.
    source
        Its name in messages.

    Raises
    ------
    InputError
        When anything is read, if the file is damaged or exceeds a limit.
    """

    def walked(self, wanted: Chosen, entered: Chosen) -> Iterator[tuple[str, Value]]:
        size = self._path.stat().st_size
        with self._path.open("rb") as file:
            little = file.read(FILE_HEADER)[-2:] == b"IM"
            start = FILE_HEADER
            while start < size:
                try:
                    file.seek(start)
                    part = Bytes(file, size - start, little)
                    tag = part.tag()
                    end = part.position + tag.size
                    if tag.kind == COMPRESSED:
                        part = Unpacked(file, tag.size, little, self._budget)
                        tag = part.tag()
                    if tag.kind != MATRIX or start + end > size:
                        raise DamagedError("the end comes too early")
                    yield from self._array(part, tag.size, "", wanted, entered)
                except DamagedError as error:
                    raise InputError(
                        f"{self._source}: the MATLAB file is damaged or cut short ({error}, in the "
                        f"variable at byte {start}); save it again with save -v7"
                    ) from None
                start += end

    def _array(
        self, part: Bytes, size: int, name: str, wanted: Chosen, entered: Chosen
    ) -> Iterator[tuple[str, Value]]:
        """The variables in one array; a name is given to those that are fields of structs."""
        self._budget.look()
        end = part.position + size
        if size == 0:  # how an empty field may be stored
            yield name, np.zeros(0) if wanted(name) else None
            return
        head = _head(part)
        inside, own = bool(name), name or head.name
        if not own or own.startswith("__"):
            return  # data that belong to objects
        if head.array_class == OPAQUE:
            self.objects[own] = _class_name(part)
        if head.holds_arrays and entered(own):
            if own.count(".") + own.count("{") >= DEEPEST:
                raise DamagedError(f"structs are more than {DEEPEST} deep")
            fields = [f".{f}" for f in _field_names(part)] if head.array_class == STRUCT else [""]
            for inner in (member + field for member in head.members for field in fields):
                tag = part.tag()
                if tag.kind != MATRIX:
                    raise DamagedError("a field of a struct or a cell is missing")
                yield from self._array(part, tag.size, own + inner, wanted, entered)
        elif not head.holds_arrays:
            yield own, self._value(part, head) if wanted(own) else None
        if inside or wanted(own) or (head.holds_arrays and entered(own)):
            part.skip_to(end)
            if not inside:
                part.finish()

    def _value(self, part: Bytes, head: _Head) -> Value:
        count = math.prod(head.shape)
        if head.array_class == TEXT:
            return "" if not count else _text(part) if head.shape[0] == 1 else None
        if head.array_class not in NUMERIC or head.is_complex:
            return None
        self._budget.read(count)
        tag = part.tag()
        if tag.kind not in NUMBERS:
            raise DamagedError(f"numbers of the unknown kind {tag.kind}")
        own = NUMBERS[CLASS_KINDS[head.array_class - NUMERIC[0]]]
        stored = NUMBERS[tag.kind]
        if stored != own and (stored[0] == "f" or int(stored[1]) >= int(own[1])):
            raise DamagedError(f"numbers of the kind {tag.kind} in an array of another")
        kind = np.dtype(f"{'<' if part.little else '>'}{stored}")
        if tag.size != count * kind.itemsize:
            raise DamagedError(f"{tag.size} bytes of numbers do not fill {_shown(head.shape)}")
        values = np.frombuffer(part.content(tag, tag.size), kind)
        return values.reshape(head.shape, order="F").squeeze()


def _head(part: Bytes) -> _Head:
    flags = part.integers(2)
    if len(flags) < 2:
        raise DamagedError("the kind of an array is missing")
    array_class = flags[0] & 0xFF
    shape: tuple[int, ...] = ()
    if array_class != OPAQUE:  # an object, which says no size
        shape = tuple(part.integers(MOST_DIMENSIONS))
        if len(shape) < 2 or min(shape) < 0:
            raise DamagedError("the size of an array is missing")
    name = part.name(LONGEST_NAME).decode("utf-8", "backslashreplace")
    return _Head(name, array_class, shape, bool(flags[0] & COMPLEX))


def _class_name(part: Bytes) -> str:
    """The class of an object, behind the name of the system of classes that it belongs to."""
    try:
        part.name(LONGEST_NAME)
        return part.name(LONGEST_NAME).decode("utf-8", "backslashreplace")
    except DamagedError:
        return "object"


def _field_names(part: Bytes) -> list[str]:
    lengths = part.integers(1)
    if len(lengths) != 1 or not 0 < lengths[0] <= LONGEST_NAME:
        raise DamagedError("the names of a struct's fields are missing")
    width = lengths[0]
    names = part.name(min(width * MOST_ARRAYS, 2**20))
    if len(names) % width:
        raise DamagedError("the names of a struct's fields are cut")
    cells = (names[i : i + width].partition(b"\0")[0] for i in range(0, len(names), width))
    return [cell.decode("utf-8", "backslashreplace") for cell in cells]


def _text(part: Bytes) -> str:
    tag = part.tag()
    if tag.kind not in TEXTS:
        raise DamagedError(f"a text of the unknown kind {tag.kind}")
    code = TEXTS[tag.kind]
    if code in ("utf-16", "utf-32"):
        code += "-le" if part.little else "-be"
    try:
        return bytes(part.content(tag, LONGEST_TEXT)).decode(code)
    except UnicodeDecodeError:
        raise DamagedError("a text cannot be decoded") from None


def _shown(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))
