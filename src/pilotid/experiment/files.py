"""What the names of files say: subject, condition, run, and whatever else a laboratory writes.

The field ``subject`` is who was recorded, ``condition`` under what; values of ``run`` are runs of
one recording, each in a file of its own.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path

from pandas import DataFrame, factorize

from pilotid.recording.files import Reading
from pilotid.recording.recording import Recording
from pilotid.recording.windows import file_of, sidecar_path, stem_of
from pilotid.support.naming import digest_of
from pilotid.support.types import InputError

#: Columns of estimates.csv behind the file and the fields, which may not be named so.
QUANTITY_COLUMNS = (
    *("run", "model", "method", "parameter", "unit", "value", "std_error", "lower_95", "upper_95"),
    *("outcome", "remarks", "determined"),
)


def fields_of(path: Path, pattern: str) -> dict[str, str] | None:
    """The values of a pattern's fields in a file's name, None where it does not fit.

    Fields are in braces and stand for letters, digits and other signs than ``_`` and ``/``; all
    else stands for itself, in any case of letters.  The pattern may match any part of the name
    without its suffix; one with a ``/`` is matched against the end of the whole path, so that
    folders may be fields.

    Parameters
    ----------
    path
        The file.
    pattern
        For example ``subj{subject}_{condition}``.

    Raises
    ------
    InputError
        If the pattern has no field, one without a name or named as a column, or one name twice.
    """
    words = re.split(r"\{([^{}]*)\}", pattern)
    names, between = words[1::2], "".join(words[::2])
    taken = {"file", *QUANTITY_COLUMNS} - {"run"}
    good = len({*names} - taken) == len(names) > 0 and all(map(str.isidentifier, names))
    if not good or "{" in between or "}" in between:
        raise InputError(
            f"--pattern '{pattern}': must have fields in braces, each with a name of its own, of "
            f"letters and no column of estimates.csv; write for example 'subj{{subject}}_"
            "{condition}'"
        )
    expression = "".join(
        f"(?P<{word}>[^_/]+)" if place % 2 else re.escape(word) for place, word in enumerate(words)
    )
    name = stem_of(path)
    if "/" in pattern:
        name = (file_of(path).parent / name).as_posix()
        expression = f"(?:^|/){expression}$"
    match = re.search(expression, name, re.IGNORECASE)
    return match.groupdict() if match else None


@dataclass(frozen=True, eq=False)
class Part:
    """One recording of an analysis: a file, or several that hold a run each.

    Attributes
    ----------
    files
        The files, in the order of their runs.
    fields
        The values of the pattern's fields, without the run; subject and condition are empty where
        the pattern does not say.
    """

    files: tuple[Path, ...]
    fields: Mapping[str, str]

    @property
    def name(self) -> str:
        """The file, as it is named in tables; the first of several."""
        return str(self.files[0])

    @property
    def condition(self) -> str:
        """Under what was recorded."""
        return self.fields["condition"]

    @property
    def stratum(self) -> tuple[str, ...]:
        """All fields but who and under what: contrasts are made within each value of them."""
        return tuple(v for name, v in self.fields.items() if name not in ("subject", "condition"))

    @property
    def group(self) -> tuple[str, ...]:
        """What recordings have in common that have one model: all but the subject."""
        return (*self.stratum, self.condition)

    @property
    def words(self) -> str:
        """The fields, as headings have them."""
        return " ".join(f"{name} {value}" for name, value in self.fields.items() if value)

    def recording(self, reading: Reading) -> Recording:
        """The recording in the files.

        Raises
        ------
        InputError
            If a file cannot be used.
        """
        (whole,) = reading.all(self.files, joint=True)[0].values()
        return whole

    def digest(self) -> str:
        """A digest of the files and of the notes beside them."""
        paths = [path for file in map(file_of, self.files) for path in (file, sidecar_path(file))]
        return digest_of(path.read_bytes() for path in paths if path.is_file())


def parts_of(files: Sequence[Path], pattern: str | None) -> tuple[list[Part], list[str]]:
    """The recordings that files hold, and a sentence for each file that is left out.

    Parameters
    ----------
    files
        As the user named them.
    pattern
        What their names say, see `fields_of`; None where each is a subject's, in one condition.
    """
    refused = list[str]()
    grouped: dict[tuple[tuple[str, str], ...], dict[str, Path]] = {}
    for file in dict.fromkeys(files):
        fields = {"subject": str(file)} if pattern is None else fields_of(file, pattern)
        if fields is None:
            refused.append(f"{file}: does not fit the pattern '{pattern}'; change it, or the name")
            continue
        run = fields.pop("run", "")
        fields |= {name: "" for name in ("subject", "condition") if name not in fields}
        first = grouped.setdefault(tuple(fields.items()), {}).setdefault(run, file)
        if first != file:
            refused.append(
                f"{file}: has the same fields as {first}; what differs must be a field of the "
                "pattern, {run} if they are runs of one recording"
            )
    parts = [
        Part(tuple(runs[run] for run in in_order(runs)), dict(fields))
        for fields, runs in grouped.items()
    ]
    return sorted(parts, key=lambda part: _natural(part.words)), refused


def without(parts: Sequence[Part], texts: Sequence[str]) -> list[Part]:
    """The recordings that stay where texts such as ``subject=6,condition=C4`` exclude some.

    Raises
    ------
    InputError
        If a text is no such thing, or excludes nothing, or all.
    """
    left = [*parts]
    for text in texts:
        pairs = (pair.partition("=") for pair in text.split(","))
        wanted = {(name.strip(), value.strip()) for name, _, value in pairs}
        before, left = left, [part for part in left if not wanted <= part.fields.items()]
        if not 0 < len(left) < len(before):
            known = in_order(f"{n}={v}" for part in parts for n, v in part.fields.items())
            raise InputError(
                f"--exclude {text}: excludes {'nothing' if left else 'all that is left'}; name "
                f"FIELD=VALUE of the pattern, of which there are {', '.join(known) or 'none'}"
            )
    return left


def pairs_of(texts: Sequence[str], conditions: Collection[str]) -> list[tuple[str, str]]:
    """The pairs of conditions in texts such as ``C3:C6``."""
    pairs = []
    for text in texts:
        first, _, second = (part.strip() for part in text.partition(":"))
        if first == second or not {first, second} <= {*conditions}:
            raise InputError(
                f"--contrast {text}: must be two conditions of {{condition}} in the pattern, as in "
                f"C3:C6; there are {', '.join(in_order(conditions)) or 'none'}"
            )
        pairs.append((first, second))
    return pairs


def in_order(values: Iterable[str]) -> list[str]:
    """Distinct values in a natural order: C2 before C10."""
    return sorted({*values}, key=_natural)


def _natural(text: str) -> tuple[str, str]:
    """What texts are sorted by, so that C2 comes before C10."""
    return re.sub(r"\d+", lambda digits: digits[0].zfill(20), text), text


def with_factors(parts: Sequence[Part], text: str | None) -> tuple[list[Part], DataFrame]:
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
        return [*parts], DataFrame()
    names = [name.strip() for name in text.split(",")]
    if all(name in part.fields for part in parts for name in names):
        parts, levels = _by_fields(parts, names)
    else:
        levels = _in_text(text)
    there = in_order(part.condition for part in parts)
    counts, unknown = levels.nunique(), [*levels.index.difference(there)]
    whole = levels.notna().all(axis=None) and not (levels.duplicated().any() or unknown)
    if not whole or (counts < 2).any() or len(levels) < prod(counts):
        raise InputError(
            "--factors: a factor must have two levels or more, and each combination of levels "
            "must be that of one condition; add a factor, or name all conditions of the files "
            f"({', '.join(there) or 'none'}), and no other {unknown or ''}"
        )
    # Every cell of the crossing in its place: levels of the first factor change last.
    return [*parts], levels.sort_values([*levels], key=lambda column: factorize(column)[0])


def _by_fields(parts: Sequence[Part], names: Sequence[str]) -> tuple[list[Part], DataFrame]:
    """Factors that are fields of the pattern: conditions named by their levels."""
    fields = DataFrame([part.fields for part in parts])
    levels = fields[[*names]]
    levels.index = levels.agg(", ".join, axis=1)
    others = fields.drop(columns=[*names]).assign(condition=levels.index).to_dict("records")
    renamed = [Part(part.files, own) for part, own in zip(parts, others, strict=True)]
    return renamed, levels.drop_duplicates().loc[in_order(levels.index)]


def _in_text(text: str) -> DataFrame:
    """Factors by condition, from a text such as ``motion=C1,C2:off;C3,C4:on``."""
    levels: dict[str, dict[str, str]] = {}
    factor = ""
    for part in filter(None, map(str.strip, text.split(";"))):
        named, equals, rest = part.rpartition("=")
        factor = named.strip() if equals else factor
        members, _, level = rest.rpartition(":")
        conditions = [*filter(None, map(str.strip, members.split(",")))]
        known = levels.setdefault(factor, {})
        if not (factor and level.strip() and conditions) or set(conditions) & set(known):
            raise InputError(
                f"--factors: '{part}' must be FACTOR=CONDITIONS:LEVEL, as in motion=C1,C2:off;"
                "C3,C4:on, and a condition has one level of a factor"
            )
        known.update(dict.fromkeys(conditions, level.strip()))
    return DataFrame(levels)
