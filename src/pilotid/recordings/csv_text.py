"""What a text file of numbers is written in: its characters, its separator, its header."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pilotid.recordings.names import shown
from pilotid.recordings.recording import is_unit
from pilotid.types import InputError

LONGEST_ROW = 2**22  # characters: the length of a row is the memory that it takes
MOST_COMMENTS = 1000  # lines before the header
#: Bytes that no text has: what is no UTF-8 and free of them is taken for Latin-1.
CONTROLS = bytes(b for b in range(32) if b not in b"\t\n\v\f\r") + b"\x7f"


def too_long(source: str, line: int) -> InputError:
    """The refusal of a row that would fill the memory."""
    return InputError(
        f"{source}: line {line} is longer than {LONGEST_ROW} characters; give every sample a line "
        "of its own"
    )


def encoding_of(path: Path, source: str) -> str:
    """How the characters of a file are written: UTF-8, UTF-16 or Latin-1.

    Raises
    ------
    InputError
        If it is no text, or has a line that would fill the memory before it can be looked at.
    """
    ended, line, at = 0, 1, 0  # bytes before the present line, its number, bytes read
    encoding, bad = "utf-8-sig", 0
    decoder = codecs.getincrementaldecoder("utf-8")()
    controls = False
    with path.open("rb") as stream:
        while block := stream.read(LONGEST_ROW):
            if not at:
                encoding = _by_mark(block)
            last = max(block.rfind(b"\n"), block.rfind(b"\r"))
            if last < 0 and at + len(block) - ended > LONGEST_ROW:
                raise too_long(source, line)
            if encoding == "utf-8-sig" and not bad:
                try:
                    decoder.decode(block)
                except UnicodeDecodeError as error:
                    bad = line + error.object.count(b"\n", 0, error.start)
            controls = controls or len(block.translate(None, CONTROLS)) < len(block)
            if last >= 0:
                line += block.count(b"\n") or block.count(b"\r")
                ended = at + last + 1
            at += len(block)
    if bad and controls:
        raise InputError(
            f"{source}: line {bad} is not UTF-8 text; save the file as CSV in UTF-8"
        ) from None
    return "latin-1" if bad else encoding


def _by_mark(block: bytes) -> str:
    """The encoding that the first bytes tell."""
    if block[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    if len(block) > 3 and block[0] and block[2] and not (block[1] or block[3]):
        return "utf-16-le"
    if len(block) > 3 and block[1] and block[3] and not (block[0] or block[2]):
        return "utf-16-be"
    return "utf-8-sig"


@dataclass(frozen=True)
class Layout:
    """Where a table begins and what separates its cells.

    Attributes
    ----------
    separator
        A comma, a semicolon, a tab, or a space for any number of them.
    line
        The number of the header's line.
    lines
        Lines read so far that belong to the table: the header, and a line behind it if it had to
        be looked at.
    """

    separator: str
    line: int
    lines: tuple[str, ...]


def layout_of(lines: Iterator[str], source: str) -> Layout:
    """The layout that the first lines of a file tell; reads no further than it must.

    Before the header there may be a line ``sep=;`` and lines that begin with # or %; the last of
    these is the header itself if numbers follow at once.
    """
    separator, number, comment = "", 1, ""
    first = next(lines, "")
    if match := re.fullmatch(r'"?sep=([,;\t ])"?\s*', first, re.IGNORECASE):
        separator, first, number = match[1], next(lines, ""), 2
    while first.lstrip().startswith(("#", "%")):
        comment, first, number = first, next(lines, ""), number + 1
        if number > MOST_COMMENTS:
            raise InputError(
                f"{source}: more than {MOST_COMMENTS} lines begin with # or %; leave them out"
            )
    if comment and _numbers(first):
        header = comment.lstrip().lstrip("#% \t")
        return Layout(separator or _separator(header), number - 1, (header, first))
    return Layout(separator or _separator(first), number, (first,))


def _separator(header: str) -> str:
    # Spreadsheets in countries with a decimal comma separate the cells by semicolons.
    best = max((",", ";", "\t"), key=header.count)
    return best if best in header or " " not in header.strip() else " "


def _numbers(line: str) -> bool:
    """Whether a line begins with a number."""
    return bool(re.match(r"\s*[-+]?[.,]?[0-9]", line))


def unit_of(cell: str) -> str | None:
    """The unit in a cell of a row of units, without its brackets; None if it is none."""
    text = cell.strip()
    if text[:1] + text[-1:] in ("[]", "()"):
        text = text[1:-1].strip()
    if not is_unit(text):
        return None
    return text if re.match(r"$|1$|-$|[^\W\d_]|[°%]", text) and not _is_float(text) else None


def _is_float(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text != "1"


def unknown_encoding(source: str, line: int) -> InputError:
    """The refusal of a line whose bytes are no text of the file's encoding."""
    return InputError(
        f"{source}: line {line} is not text as the rest of the file is ({shown('UTF-16')}); save "
        "the file as CSV in UTF-8"
    )
