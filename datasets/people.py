"""Published recordings of people: what they are (`people.csv`), and where their files are.

None of them comes with pilotid.  `people_files.csv` has the SHA-256 of every file, so that results
say which recordings they are of.
"""

from __future__ import annotations

import csv
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from pilotid.support.types import InputError

HERE = Path(__file__).parent
#: The variable that names the folder of fetched files.
FOLDER = "PILOTID_DATA"


@dataclass(frozen=True)
class People:
    """What is known of an experiment: its data card.

    Attributes
    ----------
    name
        What `fetch` takes.
    who, task, rate
        Subjects, what they did, and how it was recorded.
    faults
        What to know before believing an estimate.
    licence, source
        Under which the files are published, and where.
    address
        Of the folder with the files; empty where none is known that gives a single file.
    files
        What commands take behind the folder.
    pattern, model
        What the names say, and a model that suits.
    mapping, dt
        How the files are read, see `pilotid.recordings.files.Reading`; empty if as usual.
    """

    name: str
    who: str
    task: str
    rate: str
    faults: str
    licence: str
    source: str
    address: str
    files: str
    pattern: str
    model: str
    mapping: str
    dt: str


def _table(name: str) -> list[list[str]]:
    with (HERE / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.reader(stream))[1:]


PEOPLE = {row[0]: People(*row) for row in _table("people.csv")}


def published(name: str) -> dict[str, str]:
    """The files of an experiment, with the SHA-256 of each."""
    return {file: digest for people, file, digest in _table("people_files.csv") if people == name}


def recordings_in(folder: Path, name: str) -> list[Path]:
    """The recordings of an experiment in a folder, as commands take them."""
    files = PEOPLE[name].files
    start, _, levels = files.partition("{")
    if levels:
        return [folder / f"{start}{level}" for level in levels.rstrip("}").split(",")]
    return sorted(folder.glob(files))


def fetch(name: str, source: Path | None = None) -> Path:
    """The folder with the files of an experiment, which are fetched where they are not there yet.

    Parameters
    ----------
    name
        One of `PEOPLE`.
    source
        A folder that has the files, to take them from; None to download them.

    Raises
    ------
    InputError
        If there is no such experiment, or a file cannot be had or is another than the published.
    """
    import pooch

    if name not in PEOPLE:
        raise InputError(f"unknown data {name!r:.50}: choose from {', '.join(PEOPLE)}")

    def copy(address: str, target: str, _: object) -> None:
        assert source is not None
        shutil.copy(source / address.rpartition("/")[2], target)

    people = PEOPLE[name]
    pooch.get_logger().setLevel("WARNING")
    folder = Path(os.environ.get(FOLDER) or pooch.os_cache("pilotid")) / name
    files = pooch.create(folder, people.address, registry=published(name))
    for file in files.registry:
        try:
            files.fetch(file, downloader=copy if source else None)
        except (OSError, ValueError) as error:  # those of the network are of the first kind
            raise InputError(
                f"{name}: {file} cannot be had ({error}); get the files from {people.source} and "
                "name their folder with --from FOLDER"
            ) from error
    return folder
