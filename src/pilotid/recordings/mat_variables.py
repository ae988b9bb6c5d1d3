"""What all readers of MATLAB files share: limits, and the choice of variables."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pilotid.recordings.names import MOST_VALUES
from pilotid.types import InputError

MOST_UNPACKED = 3 * 2**28  # bytes that compressed variables may hold, in all
MOST_ARRAYS = 10_000  # variables and fields of structs
DEEPEST = 8  # structs inside structs
LONGEST_TEXT = 2**16  # characters

Value = NDArray[np.generic] | str | None  # None: neither real numbers nor a text
Chosen = Callable[[str], bool]


class DamagedError(Exception):
    """A file is not what its format wants, or exceeds a limit; says in which way."""


class Budget:
    """What may still be read from a file."""

    def __init__(self) -> None:
        self._unpacked, self._values = MOST_UNPACKED, MOST_VALUES
        self._arrays = 2 * MOST_ARRAYS  # names are looked at before values

    def unpack(self, size: int) -> None:
        """Count unpacked bytes."""
        self._unpacked -= size
        if self._unpacked < 0:
            raise DamagedError(f"variables that unpack to more than {MOST_UNPACKED >> 20} MB")

    def look(self) -> None:
        """Count an array that is looked at."""
        self._arrays -= 1
        if self._arrays < 0:
            raise DamagedError(f"more than {MOST_ARRAYS} variables")

    def read(self, count: int) -> None:
        """Count values."""
        self._values -= count
        if self._values < 0:
            raise DamagedError(f"more than {MOST_VALUES} values, too many for a recording")


def chosen(names: Collection[str], struct: str) -> tuple[Chosen, Chosen]:
    """Which variables to read and which structs to enter, for some names and a whole struct."""

    def wanted(name: str) -> bool:
        return name in names or name == struct or name.startswith(f"{struct}.")

    def entered(name: str) -> bool:
        inside = tuple(f"{name}{sign}" for sign in ".({")
        return wanted(name) or any(other.startswith(inside) for other in names)

    return wanted, entered


def family(name: str) -> str:
    """The name that the members of an array have in common: ``data(2).u`` is of ``data.u``.

    Arrays of structs and cells hold runs; each is a variable of its own here.
    """
    return _MEMBER.sub("", name)


_MEMBER = re.compile(r"\([0-9]+\)|\{[0-9]+\}")


def collected(found: Iterable[tuple[str, Value]], wanted: Chosen, source: str) -> dict[str, Value]:
    """The wanted variables by name.

    Raises
    ------
    InputError
        If two have one name.
    """
    values: dict[str, Value] = {}
    for name, value in found:
        if wanted(name):
            if name in values:
                raise InputError(
                    f"{source}: has more than one variable {name}; save it again with save -v7"
                )
            values[name] = value
    return values


class Variables(ABC):
    """The variables of a file; a format says in `walked` how they are found.

    Each call may raise an `InputError`, if the file is damaged or exceeds a limit.

    Parameters
    ----------
    path
        The file.
    source
        Its name in messages.
    """

    def __init__(self, path: Path, source: str) -> None:
        self._path, self._source = path, source
        self.objects: dict[str, str] = {}  # names and classes of what is no array, once walked
        self._budget = Budget()

    @abstractmethod
    def walked(self, wanted: Chosen, entered: Chosen) -> Iterator[tuple[str, Value]]:
        """All variables by name, with the values of the wanted ones."""

    def names(self, deep: bool) -> list[str]:
        """Names of all variables but structs and cells; with `deep` also of those inside these."""
        return [name for name, _ in self.walked(lambda name: False, lambda name: deep)]

    def read(self, names: Collection[str], struct: str) -> dict[str, Value]:
        """The variables of some names, and everything inside the struct of some name.

        Arrays come without dimensions of size 1.
        """
        wanted, entered = chosen(names, struct)
        return collected(self.walked(wanted, entered), wanted, self._source)
