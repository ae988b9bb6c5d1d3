"""What the names of files say: subject, condition, run, and whatever else a laboratory writes."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

from pilotid.recording.files import Reading
from pilotid.recording.recording import Recording
from pilotid.recording.windows import file_of, of_runs, sidecar_path, stem_of
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

#: The field of a pattern that names who was recorded, and the one that names under what.
SUBJECT, CONDITION = "subject", "condition"
#: The field whose values are runs of one recording, each in a file of its own.
RUN = "run"

FIELD = re.compile(r"\{([^{}]*)\}")

#: Columns of estimates.csv that a field may not be named as.
TAKEN = (
    "file", "model", "method", "parameter", "unit", "value", "std_error", "lower_95", "upper_95",
    "outcome", "remarks", "determined",
)  # fmt: skip


@dataclass(frozen=True)
class Pattern:
    """A pattern such as ``subj{subject}_{condition}`` for the names of files.

    Fields are in braces and stand for letters, digits and other signs than ``_`` and ``/``; all
    else stands for itself, in any case of letters.  The pattern may match any part of the name
    without its suffix; one with a ``/`` is matched against the end of the whole path, so that
    folders may be fields.

    Parameters
    ----------
    text
        The pattern.

    Raises
    ------
    InputError
        If it has no field, one without a name, or one name twice.
    """

    text: str

    def __post_init__(self) -> None:
        names = FIELD.findall(self.text)
        wrong = [n for n in names if not re.fullmatch(r"[A-Za-z]\w{0,30}", n, re.ASCII)]
        rest = FIELD.sub("", self.text)
        if not names or wrong or len(set(names)) < len(names) or set("{}") & set(rest):
            raise InputError(
                f"--pattern '{self.text}': must have fields in braces, each with its own name of "
                "letters; write for example 'subj{subject}_{condition}'"
            )
        if taken := [n for n in names if n in TAKEN]:
            raise InputError(
                f"--pattern '{self.text}': {taken[0]} is a column of its own in the tables; give "
                "that field another name"
            )

    def match(self, path: Path) -> dict[str, str] | None:
        """The values of the fields in a file's name, None where it does not fit."""
        whole = "/" in self.text
        own = stem_of(path)
        name = (file_of(path).parent / own).as_posix() if whole else own
        parts = FIELD.split(self.text)
        expression = "".join(
            f"(?P<{part}>[^_/]+?)" if index % 2 else re.escape(part)
            for index, part in enumerate(parts)
        )
        if whole:
            expression = f"(?:^|/){expression}$"
        elif not parts[-1]:  # the last field takes all that it can
            expression += "(?![^_])"
        found = re.search(expression, name, re.IGNORECASE)
        return found.groupdict() if found else None


@dataclass(frozen=True)
class Part:
    """One recording of an analysis: a file, or several that hold a run each.

    Attributes
    ----------
    files
        The files, in the order of their runs.
    fields
        What the pattern found, without the run, as pairs of field and value.
    """

    files: tuple[Path, ...]
    fields: tuple[tuple[str, str], ...]

    @property
    def name(self) -> str:
        """The file, as it is named in tables; the first of several."""
        return str(self.files[0])

    def field(self, name: str) -> str:
        """The value of a field; empty where the pattern has no such field."""
        return dict(self.fields).get(name, "")

    @property
    def stratum(self) -> tuple[str, ...]:
        """All fields but who and under what: contrasts are made within each value of them."""
        return tuple(value for name, value in self.fields if name not in (SUBJECT, CONDITION))

    @property
    def words(self) -> str:
        """The fields, or else the file's name, as headings have it."""
        fields = " ".join(f"{field} {value}" for field, value in self.fields)
        return fields or stem_of(self.files[0])

    def recording(self, reading: Reading) -> Recording:
        """The recording in the files.

        Raises
        ------
        InputError
            If a file cannot be used.
        """
        (whole,), _ = reading.all(self.files, joint=True)
        return whole

    def digest(self) -> str:
        """A digest of the files and of the notes beside them."""
        digest = hashlib.sha256()
        for file in map(file_of, self.files):
            for path in (file, sidecar_path(file)):
                with suppress(OSError):  # that a file cannot be read is said as it is read
                    digest.update(path.read_bytes())
        return digest.hexdigest()


def parts_of(files: Sequence[Path], pattern: Pattern | None) -> tuple[list[Part], list[str]]:
    """The recordings that files hold, and a sentence for each file that is left out.

    Parameters
    ----------
    files
        As the user named them.
    pattern
        What their names say; None for nothing.
    """
    if pattern is None:
        return [Part((file,), ()) for file in dict.fromkeys(files)], []
    refused, unfit = list[str](), list[Path]()
    grouped: dict[tuple[tuple[str, str], ...], dict[str, Path]] = {}
    for file in dict.fromkeys(files):
        found = pattern.match(file)
        if found is None:
            unfit.append(file)
            continue
        run = found.pop(RUN, "")
        first = grouped.setdefault(tuple(found.items()), {}).setdefault(run, file)
        if first != file:
            refused.append(
                f"{file}: has the same fields as {first}; what differs must be a field of the "
                "pattern, {run} if they are runs of one recording"
            )
    if unfit:
        more = f", and {len(unfit) - 1} more files" if unfit[1:] else ""
        refused.append(
            f"{unfit[0]}{more}: the name does not fit the pattern '{pattern.text}'; change the "
            "pattern, or leave the file out"
        )
    parts = [
        Part(tuple(held[run] for run in in_order([*held])), fields)
        for fields, held in grouped.items()
    ]
    order = in_order([part.words for part in parts])
    return sorted(parts, key=lambda part: order.index(part.words)), refused


def alone(recording: Recording, run: int) -> Recording:
    """One run of a recording, counted from 1."""
    return of_runs(recording, [run], f"run {run}")


def without(recording: Recording, run: int) -> Recording:
    """All runs of a recording but one, counted from 1."""
    others = [other for other in range(1, recording.runs + 1) if other != run]
    return of_runs(recording, others, f"without run {run}")


def excluded_of(parts: Sequence[Part], texts: Sequence[str]) -> tuple[list[Part], list[Part]]:
    """The recordings that stay, and those that texts such as ``subject=6,condition=C4`` exclude.

    Raises
    ------
    InputError
        If a text is no such thing, or excludes nothing, or all.
    """
    left, excluded = list(parts), list[Part]()
    for text in texts:
        pairs = (pair.partition("=") for pair in text.split(","))
        wanted = {(name.strip(), value.strip()) for name, _, value in pairs}
        out = [part for part in left if wanted <= {*part.fields}]
        if not out or len(out) == len(left):
            known = ", ".join(in_order([f"{n}={v}" for part in parts for n, v in part.fields]))
            raise InputError(
                f"--exclude {text}: excludes {'all that is left' if out else 'nothing'}; name "
                f"FIELD=VALUE of the pattern, of which there are {known or 'none'}"
            )
        left = [part for part in left if part not in out]
        excluded += out
    return left, excluded


def in_order(values: Sequence[str]) -> list[str]:
    """Distinct values in a natural order: C2 before C10."""

    def key(text: str) -> list[tuple[bool, int, str]]:
        return [
            (not part.isdigit(), int(part) if part.isdigit() else 0, part)
            for part in re.split(r"(\d+)", text)
        ]

    return sorted(set(values), key=key)


def with_factors(parts: Sequence[Part], text: str | None) -> tuple[list[Part], DataFrame | None]:
    """Recordings with a condition each, and the level of each factor (columns) by condition.

    Parameters
    ----------
    parts
        The recordings.
    text
        Factors as in ``motion=C1,C2:off;C3,C4:on``, or fields of the pattern, ``motion,dynamics``,
        whose levels together are the condition; None for no factors.

    Raises
    ------
    InputError
        If it is neither, or the conditions are no full crossing.
    """
    if text is None:
        return [*parts], None
    names = [name.strip() for name in text.split(",")]
    if all(part.field(name) for part in parts for name in names):
        parts, levels = _by_fields(parts, names)
    else:
        levels = _in_text(text)
    there = in_order([part.field(CONDITION) for part in parts])
    for condition in levels.index.difference(there):
        raise InputError(
            f"--factors: no file has the condition {condition}; the conditions are "
            f"{', '.join(filter(None, there)) or 'none'}"
        )
    for condition, factor in product(levels.index, levels.columns):
        if not isinstance(levels.loc[condition, factor], str):
            raise InputError(f"--factors: the condition {condition} has no level of {factor}")
    counts = levels.nunique()
    for factor in counts.index[counts < 2]:
        raise InputError(f"--factors: {factor} has one level only; give it two or more")
    if levels.duplicated().any() or len(levels) < prod(counts):
        raise InputError(
            "--factors: each combination of levels must be that of one condition; add a factor, or "
            "name all conditions"
        )
    return [*parts], levels


def _by_fields(parts: Sequence[Part], names: Sequence[str]) -> tuple[list[Part], DataFrame]:
    """Factors that are fields of the pattern: conditions named by their levels."""
    from pandas import DataFrame

    found, rows = list[Part](), dict[str, dict[str, str]]()
    for part in parts:
        levels = {name: part.field(name) for name in names}
        condition = ", ".join(levels.values())
        rows[condition] = levels
        others = (pair for pair in part.fields if pair[0] not in names)
        found.append(Part(part.files, (*others, (CONDITION, condition))))
    return found, DataFrame.from_dict(rows, orient="index").loc[in_order([*rows])]


def _in_text(text: str) -> DataFrame:
    """Factors by condition, from a text such as ``motion=C1,C2:off;C3,C4:on``."""
    from pandas import DataFrame

    levels: dict[str, dict[str, str]] = {}
    factor = ""
    for part in filter(None, map(str.strip, text.split(";"))):
        named, equals, rest = part.rpartition("=")
        factor = named.strip() if equals else factor
        members, _, level = rest.rpartition(":")
        conditions = [name.strip() for name in members.split(",") if name.strip()]
        known = levels.setdefault(factor, {})
        if not (factor and level.strip() and conditions) or set(conditions) & set(known):
            raise InputError(
                f"--factors: '{part}' must be FACTOR=CONDITIONS:LEVEL, as in motion=C1,C2:off;"
                "C3,C4:on, and a condition has one level of a factor"
            )
        known.update(dict.fromkeys(conditions, level.strip()))
    if not levels:
        raise InputError("--factors: names no factor; write for example motion=C1,C2:off;C3,C4:on")
    return DataFrame(levels)
