"""Elements of MATLAB v5 files: tag and content, plain or compressed, and never past their end."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import BinaryIO, Literal

from pilotid.recordings.mat_variables import Budget, DamagedError

MATRIX, COMPRESSED = 14, 15
PIECE = 2**18  # bytes that are unpacked at once


@dataclass(frozen=True)
class Tag:
    """Kind and size [bytes] of an element; a small one holds its content in the tag."""

    kind: int
    size: int
    content: bytes | None


class Bytes:
    """Bytes of a file from its present position on, read once and in order.

    Parameters
    ----------
    file
        Open at the first byte.
    size
        Number of bytes.
    little
        Whether numbers have their lowest byte first.
    """

    def __init__(self, file: BinaryIO, size: int, little: bool) -> None:
        self.little = little
        self.position = 0
        self._file, self._size = file, size

    def take(self, size: int) -> bytes | bytearray:
        """The next bytes."""
        self.position += size
        taken = self._file.read(size) if self.position <= self._size else b""
        if len(taken) < size:
            raise DamagedError("the end comes too early")
        return taken

    def skip(self, size: int) -> None:
        """Leave out bytes."""
        self.position += size
        if self.position > self._size:
            raise DamagedError("the end comes too early")
        self._file.seek(size, 1)

    def finish(self) -> None:
        """Check what can be checked only at the end."""

    def skip_to(self, end: int) -> None:
        """Leave out the rest of an element."""
        if self.position > end:
            raise DamagedError("a part is larger than the whole")
        self.skip(end - self.position)

    def tag(self) -> Tag:
        """The next tag."""
        words = self.take(8)
        kind = int.from_bytes(words[:4], self._order)
        if kind >> 16:  # a small element has its size in the upper half
            size = kind >> 16
            if size > 4:
                raise DamagedError(f"a small part claims {size} bytes")
            return Tag(kind & 0xFFFF, size, bytes(words[4 : 4 + size]))
        return Tag(kind, int.from_bytes(words[4:], self._order), None)

    def content(self, tag: Tag, most: int) -> bytes | bytearray:
        """What belongs to a tag just read."""
        if tag.size > most:
            raise DamagedError(f"a part claims {tag.size} bytes where at most {most} can be")
        if tag.content is not None:
            return tag.content
        content = self.take(tag.size)
        self.skip(-tag.size % 8)
        return content

    def integers(self, most: int) -> list[int]:
        """The next element, which must hold whole numbers of 32 bits."""
        tag = self.tag()
        content = self.content(tag, 4 * most)
        if tag.kind not in (5, 6) or len(content) % 4:
            raise DamagedError("whole numbers are missing")
        pieces = (content[i : i + 4] for i in range(0, len(content), 4))
        return [int.from_bytes(piece, self._order, signed=tag.kind == 5) for piece in pieces]

    def name(self, most: int) -> bytes:
        """The next element, which must hold a name."""
        tag = self.tag()
        if tag.kind not in (1, 2, 16):
            raise DamagedError("a name is missing")
        return bytes(self.content(tag, most))

    @property
    def _order(self) -> Literal["little", "big"]:
        return "little" if self.little else "big"


class Unpacked(Bytes):
    """The same of a compressed element, unpacked no further than it is read."""

    def __init__(self, file: BinaryIO, size: int, little: bool, budget: Budget) -> None:
        super().__init__(file, size, little)
        self._packed_left = size
        self._budget = budget
        self._inflate = zlib.decompressobj()

    def take(self, size: int) -> bytearray:
        taken = bytearray()
        while len(taken) < size:
            taken += self._piece(size - len(taken))
        self.position += size
        return taken

    def skip(self, size: int) -> None:
        self.position += size
        while size > 0:
            size -= len(self._piece(size))

    def finish(self) -> None:
        """Unpack the rest, so that the checksum is compared."""
        while not self._inflate.eof:
            self._piece(PIECE, or_end=True)

    def _piece(self, size: int, *, or_end: bool = False) -> bytes:
        """Some of the next bytes; none only at the end, if that is allowed."""
        piece = b""
        while not piece and not self._inflate.eof:
            packed = self._inflate.unconsumed_tail
            if not packed:
                packed = self._file.read(min(PIECE, self._packed_left))
                self._packed_left -= len(packed)
            ended = not packed
            try:
                piece = self._inflate.decompress(packed, min(size, PIECE))
            except zlib.error:
                raise DamagedError("its compressed bytes are changed") from None
            if ended and not piece and not self._inflate.eof:
                break
        if not piece and not (or_end and self._inflate.eof):
            raise DamagedError("the end comes too early")
        self._budget.unpack(len(piece))
        return piece
