"""Published recordings of people: what they are (`people.csv`), and where their files are.

None of them comes with pilotid.  `people_files.csv` has the SHA-256 of every file, so that results
say which recordings they are of.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

from pilotid.support.types import InputError

HERE = Path(__file__).parent
#: The variable that names the folder of fetched files.
FOLDER = "PILOTID_DATA"


def _table(name: str) -> list[dict[str, str]]:
    with (HERE / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


#: The data card of each experiment by its name: ``who``, ``task`` and ``rate`` of recording;
#: ``faults``, to know before believing an estimate; ``licence``, ``source``, and ``address`` of the
#: folder with the files, empty where none is known that gives a single file; ``files`` behind the
#: folder, with the ``pattern`` of their names, a ``model`` that suits, and ``map`` and ``dt`` as
#: `pilotid.recording.files.Reading` takes them.
PEOPLE = {row["name"]: row for row in _table("people.csv")}


def published(name: str) -> dict[str, str]:
    """The files of an experiment, with the SHA-256 of each."""
    rows = _table("people_files.csv")
    return {row["file"]: row["sha256"] for row in rows if row["name"] == name}


def recordings_in(folder: Path, name: str) -> list[Path]:
    """The recordings of an experiment in a folder, as commands take them."""
    files = PEOPLE[name]["files"]
    start, _, levels = files.partition("{")
    if levels:
        return [folder / f"{start}{level}" for level in levels.rstrip("}").split(",")]
    return sorted(folder.glob(files))


def folder_of(name: str) -> Path:
    """Where the files of an experiment are, or would be."""
    import pooch

    return Path(os.environ.get(FOLDER) or pooch.os_cache("pilotid")) / name


def fetch(name: str) -> Path:
    """The folder with the files of an experiment, which are fetched where they are not there yet.

    Parameters
    ----------
    name
        One of `PEOPLE`.

    Raises
    ------
    InputError
        If there is no such experiment, or a file cannot be had or is another than the published.
    """
    import pooch

    if name not in PEOPLE:
        raise InputError(f"unknown data {name!r:.50}: choose from {', '.join(PEOPLE)}")
    people = PEOPLE[name]
    pooch.get_logger().setLevel("WARNING")
    folder = folder_of(name)
    files = pooch.create(folder, people["address"], registry=published(name))
    for file in files.registry:
        try:
            files.fetch(file)
        except (OSError, ValueError) as error:  # those of the network are of the first kind
            raise InputError(
                f"{name}: {file} cannot be had ({error}); get the files from "
                f"{people['source']} and put them into {folder}"
            ) from error
    return folder
