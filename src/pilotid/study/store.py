"""The store of a study: one SQLite file that survives whatever stops the process.

Every fit is one transaction in write-ahead mode: what was committed is there after a
crash, and what was not is simply fitted again.  The store also keeps all that a report
needs (truth, bounds, settings, versions), so that it is made from the store alone.  What is
read has a checksum that holds; see `pilotid.study.opening` for files that are damaged.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import Any

from pilotid.disk import write_file
from pilotid.study import tables
from pilotid.study.entries import (
    Draw,
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Track,
    Unit,
)
from pilotid.study.kept import KEPT, packed, unpack
from pilotid.study.opening import in_memory, in_words, merge, open_to_read, open_to_write
from pilotid.study.tables import FORMAT, Held, Row, real
from pilotid.types import InputError

__all__ = ["FORMAT", "KEPT", "STORE", "Store"]

STORE = "study.sqlite"


class Store:
    """A study's results in a folder.

    Parameters
    ----------
    folder
        The study's folder.  Where it holds rows in their small form alone (see
        `pilotid.study.kept`), these are read, and a store that is made begins with them.
    create
        Whether to write: the store is made if there is none, and mended if it is damaged.
        A store that is only read may be on a medium that cannot be written.
    small
        Whether to read the small form though there is a store.

    Attributes
    ----------
    path
        The file.
    warning
        What the user should know of damage; empty if there is none.
    """

    def __init__(self, folder: Path, *, create: bool = False, small: bool = False) -> None:
        self.path = folder / STORE
        self.warning = ""
        self._writes = create
        try:
            missing = not create and not self.path.exists()
            kept = (folder / KEPT).exists()
        except OSError:  # a folder that may not be looked into, which opening tells
            missing = kept = False
        if missing and not kept:
            raise InputError(
                f"{self.path}: there is no such file; name a folder that `pilotid compare` wrote"
            )
        if missing or small:
            self.path = folder / KEPT
            self._base = in_memory()
            unpack(self.path, self._base)
            return
        with in_words(self.path):
            self._base, told = (open_to_write if create else open_to_read)(self.path)
        self.warning = str(InputError(told)) if told else ""  # printable, as refusals are
        if create and kept:
            with self._transaction():
                if "seed" not in tables.facts(self._base)[0]:
                    unpack(folder / KEPT, self._base)

    def close(self) -> None:
        """Close the file; the write-ahead log is merged into it."""
        if self._writes:
            merge(self._base)
        self._base.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with in_words(self.path):
            self._base.execute("BEGIN IMMEDIATE")
            with self._base:  # commits, or rolls back if something fails
                yield

    # ----------------------------------------------------------------------------- writing

    def describe(self, about: Mapping[str, str]) -> None:
        """Keep facts on the study."""
        with self._transaction():
            tables.describe(self._base, about)

    def add_scenario(self, entry: ScenarioEntry) -> None:
        """Keep what a scenario is; one that is known already stays as it is."""
        e = entry
        row = (e.name, e.position, e.description, e.model, _json(e.settings))
        parts = [
            (e.name, p.parameter, place, p.unit, real(p.truth), real(p.bound))
            for place, p in enumerate(e.parameters)
        ]
        with self._transaction():
            tables.put(self._base, "scenarios", (*row, e.family, e.code, e.typed), parts)

    def add_method(self, entry: MethodEntry) -> None:
        """Keep what a method is; one that is known already stays as it is."""
        e = entry
        with self._transaction():
            row = (e.label, e.position, _json(e.settings), e.code, e.typed)
            tables.put(self._base, "methods", row)

    def forget(self, units: Iterable[Unit]) -> None:
        """Drop fits, which are then fitted again."""
        with self._transaction():
            for unit in units:
                tables.drop(self._base, "fits", astuple(unit))

    def add(self, result: Result) -> None:
        """Keep a fit and what was drawn for it; one that is known already stays as it is.

        Raises
        ------
        InputError
            If another pilot was drawn for other fits of the replication.
        """
        r, unit = result, astuple(result.unit)
        row = (*unit, r.outcome, r.message, int(r.usable), real(r.vaf), int(r.iterations))
        row = (*row, int(r.posterior), real(r.seconds), real(r.excess), r.remarks)
        row = (*row, json.dumps([astuple(track) for track in r.tracks]) if r.tracks else "")
        estimates = [(*unit, name, *map(real, numbers)) for name, *numbers in r.estimates]
        with self._transaction():
            if r.draw is not None:
                self._add_draw(r.unit, r.draw)
            tables.put(self._base, "fits", row, estimates)

    def _add_draw(self, unit: Unit, draw: Draw) -> None:
        """Keep what was drawn for a replication; the caller has a transaction."""
        key = (unit.scenario, unit.replication)
        held = list(tables.held(self._base, "draws", "WHERE scenario = ? AND replication = ?", key))
        if held and not draw.same(_draw(held[0].row)):
            raise InputError(
                f"{self.path}: holds fits of another pilot for replication {unit.replication} of "
                f"{unit.scenario}, drawn by other code; name another folder with --out"
            )
        parameters = [[p.parameter, p.unit, real(p.truth), real(p.bound)] for p in draw.parameters]
        row = (*key, draw.model, json.dumps(parameters), _json(draw.facts))
        tables.put(self._base, "draws", row)

    def keep(self, folder: Path) -> Path:
        """Write all rows in their small form into a folder; returns the file."""
        path = folder / KEPT
        with in_words(self.path):
            content = packed(self._base)
        write_file(path, content)
        return path

    # ----------------------------------------------------------------------------- reading

    def about(self) -> dict[str, str]:
        """Facts on the study."""
        with in_words(self.path):
            held, whole = tables.facts(self._base)
        self._require(whole)
        return held

    def done(self) -> dict[Unit, str]:
        """The fits that are in the store, and how they ended."""
        return {Unit(*row[:3]): row[3] for row, _ in self._held("fits")}

    def scenarios(self) -> list[ScenarioEntry]:
        """The scenarios, in the order of the catalogue."""
        entries = []
        for (name, position, words, model, settings, *others), parts in self._held("scenarios"):
            parts = sorted(parts, key=lambda part: part[2])
            known = tuple(ParameterTruth(key, *numbers) for _, key, _, *numbers in parts)
            entries.append(
                ScenarioEntry(name, position, words, model, json.loads(settings), known, *others)
            )
        return sorted(entries, key=lambda entry: (entry.position, entry.name))

    def methods(self) -> dict[str, MethodEntry]:
        """The methods by their labels, in the order of the catalogue."""
        entries = [
            MethodEntry(label, position, json.loads(settings), *others)
            for (label, position, settings, *others), _ in self._held("methods")
        ]
        entries.sort(key=lambda entry: (entry.position, entry.label))
        return {entry.label: entry for entry in entries}

    def results(self) -> Iterator[Result]:
        """All fits, by scenario, method and replication in the order of the catalogues."""
        scenarios, methods = self.scenarios(), list(self.methods())
        draws = self.draws()
        by_cell: dict[tuple[str, str], list[tuple[Row, list[Row]]]] = {}
        for row, parts in self._held("fits"):
            by_cell.setdefault(row[:2], []).append((row, parts))
        for scenario in scenarios:
            for method in methods:
                for row, parts in by_cell.get((scenario.name, method), ()):
                    draw = draws.get((scenario.name, row[2]))
                    known = scenario.parameters if draw is None else draw.parameters
                    yield _result(row, parts, draw, [p.parameter for p in known])

    def draws(self) -> dict[tuple[str, int], Draw]:
        """What populations drew, by their names and the replications."""
        return {row[:2]: _draw(row) for row, _ in self._held("draws")}

    def _held(self, table: str) -> Iterator[tuple[Row, list[Row]]]:
        """Rows with their parts, in the order of their keys."""
        with in_words(self.path):
            found: list[Held] = list(tables.held(self._base, table))
        self._require(all(each.whole for each in found))
        return ((each.row, each.parts) for each in found)

    def _require(self, whole: bool) -> None:
        if not whole:
            raise InputError(
                f"{self.path}: was damaged since it was opened (a checksum does not hold); the "
                "same command keeps what is whole"
            )


def _result(row: Row, parts: list[Row], draw: Draw | None, order: list[str]) -> Result:
    *unit, outcome, message, usable, vaf, count, posterior, seconds, excess, remarks, tracks = row
    known = [part for part in parts if part[3] in order]
    return Result(
        Unit(*unit),
        outcome,
        message,
        bool(usable),
        vaf,
        count,
        bool(posterior),
        seconds,
        tuple(part[3:] for part in sorted(known, key=lambda part: order.index(part[3]))),
        excess,
        draw,
        remarks,
        tuple(_track(row) for row in json.loads(tracks or "[]")),
    )


def _track(row: Row) -> Track:
    key, before, during, after, whole, lag, coverage, values = row
    return Track(key, before, during, after, whole, lag, coverage, tuple(values))


def _draw(row: Row) -> Draw:
    _, _, model, parameters, facts = row
    known = tuple(ParameterTruth(*parameter) for parameter in json.loads(parameters))
    return Draw(model, known, json.loads(facts))


def _json(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, allow_nan=False)
