"""Recordings of people that others have published: what they are, and where their files are.

None of them comes with pilotid.  `people.csv` has the size and the SHA-256 of every file, so that
results say which recordings they are of.
"""

from __future__ import annotations

import csv
import hashlib
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pilotid.disk import make_folder, require_file, write_file
from pilotid.types import InputError

TABLE = Path(__file__).with_name("people.csv")
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
    licence
        Under which the files are published.
    source
        Publication and page.
    address
        Of the folder with the files; empty where none is known that gives a single file.
    files
        What commands take behind the folder.
    pattern, model
        What the names say, and a model that suits.
    mapping, dt
        How the files are read, see `pilotid.recordings.files.Reading`.
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
    model: str = "auto"
    mapping: str = ""
    dt: float | None = None

    @property
    def options(self) -> str:
        """What commands need to read the files."""
        given = [f"--pattern '{self.pattern}'"]
        given += [f"--map {self.mapping}"] * bool(self.mapping)
        given += [f"--dt {self.dt:.6g}"] if self.dt else []
        return " ".join([*given, f"--model {self.model}"])


@dataclass(frozen=True)
class Published:
    """A file, its length in bytes and its SHA-256."""

    name: str
    size: int
    digest: str


_YAW = "github.com/vikkoss/ae2224I_measurement_data_2024--1-"
PEOPLE = {
    people.name: people
    for people in (
        People(
            "yaw",
            "pilots 1, 3, 4 and 6 of six; C1 to C3 without motion, C4 to C6 with it",
            "compensatory yaw, target and disturbance; a gain, 4/(s(1+s/30)^2), 15/s^2",
            "100 Hz, 5 runs of 81.92 s, one period of the forcing functions, no run-in",
            "x is half a sample ahead of u; the elements of C1 and C4 are gains, where values rest "
            "on the model of the remnant",
            "none is named",
            f"course AE2224-I, Delft University of Technology; {_YAW}",
            "https://raw.githubusercontent.com/vikkoss/ae2224I_measurement_data_2024--1-/"
            "4095f459beed77dc46d697485f3a517db04cda43/",
            "*.mat",
            "subj{subject}_{condition}",
        ),
        People(
            "adaptation",
            "pilots 2, 3, 4, 7 and 8 of nine; conditions C1 to C8 of nine",
            "compensatory roll and pitch at once, target only; the element of one axis or both "
            "changes within the run in C3 to C8",
            "100 Hz, 6 runs of 81.92 s after 8 s of run-in",
            "a large breakout holds u at 0 for 30 to 70 % of the time; samples of x are lost in "
            "both axes of pilot 4, C3 and C7, and pilot 7, C5, and in roll of pilot 7, C8",
            "MIT",
            "P. M. T. Zaal, JGCD 39(5), 2016, doi 10.2514/1.G001592",
            "",
            "*.mat",
            "pilot{subject}_{condition}_{axis}",
        ),
        People(
            "preview",
            "subjects zu and iz of seven",
            "target displayed ahead of time, target and disturbance on exchanged prime lines; 1/s "
            "(fo) and 1/(s(s+1)) (so)",
            "60 Hz, a run of 45 s in each file: 5 s of ramp, two periods of 20 s",
            "targets are seen about half a second ahead, so that models without look-ahead do not "
            "suit; names say the lines and the sign of each file",
            "none is named",
            "M. Yamagami et al., IFAC-PapersOnLine 51(34), 2019, doi 10.1016/j.ifacol.2019.01.025; "
            "github.com/EmDash00/HILSuperposition-2017",
            "",
            "*.csv",
            "_{subject}_{condition}_r-{target}_d-{disturbance}_s49_{order}_{run}",
            "look-ahead",
            "t=time,ft=ref,u=inp,fd=dis,x=state",
        ),
        People(
            "following",
            "subject LKC; six widths of the target (sigma, arcmin), 20 trials each",
            "a cursor follows a target that walks at random, without a displayed error",
            "60 Hz, 120 trials of 20 s, no run-in",
            "the response is in whole pixels with a large mean; there is no controlled element and "
            "no line of a forcing function",
            "none is named",
            "K. Bonnen et al., Journal of Vision 15(3):14, 2015; "
            "github.com/kbonnen/BonnenEtAl2015_KalmanFilterCode",
            "",
            "data.mat::sigma={11,13,17,21,25,29}",
            "sigma={condition}",
            "following",
            "ft=target,u=response,x=response",
            1.0 / 60.0,
        ),
    )
}


@cache
def published() -> Mapping[str, tuple[Published, ...]]:
    """The files of each experiment."""
    found: dict[str, tuple[Published, ...]] = {}
    with TABLE.open(encoding="utf-8", newline="") as stream:
        for name, file, size, digest in list(csv.reader(stream))[1:]:
            found[name] = (*found.get(name, ()), Published(file, int(size), digest))
    return found


def people_named(name: str) -> People:
    """The experiment of that name; an `InputError` if there is none."""
    if name not in PEOPLE:
        raise InputError(f"unknown data {name!r:.50}: choose from {', '.join(PEOPLE)}")
    return PEOPLE[name]


def data_folder() -> Path:
    """Where fetched files are: the folder that PILOTID_DATA names, or one of the user's caches."""
    if named := os.environ.get(FOLDER):
        return Path(named)
    windows = os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else None
    above = windows or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(above) / "pilotid"


def recordings_in(folder: Path, name: str) -> list[Path]:
    """The files of an experiment in a folder, as commands take them."""
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
    people_named(name)
    folder = data_folder() / name
    lacking = [file for file in published()[name] if not _is_there(folder / file.name, file)]
    if lacking:
        make_folder(folder)
        if source is None:
            _download(PEOPLE[name], lacking, folder)
        else:
            _take(PEOPLE[name], lacking, folder, source)
    return folder


def _is_there(path: Path, file: Published) -> bool:
    """Whether a path is that file."""
    if not path.is_file() or path.stat().st_size != file.size:
        return False
    return hashlib.sha256(path.read_bytes()).hexdigest() == file.digest


def _take(people: People, lacking: Iterable[Published], folder: Path, source: Path) -> None:
    """Copy files from a folder, or one of the experiment's name in it."""
    for file in lacking:
        places = [source / file.name, source / people.name / file.name]
        there = next((place for place in places if place.exists()), places[0])
        require_file(there, 2**30)
        if not _is_there(there, file):
            raise InputError(
                f"{there}: is not the file that was published (its size or SHA-256 differs); get "
                f"it again from {people.source}"
            )
        write_file(folder / file.name, there.read_bytes())


def _download(people: People, lacking: Iterable[Published], folder: Path) -> None:
    """Download files with pooch, which holds each against its checksum."""
    by_hand = f"get the files from {people.source} and name their folder with --from FOLDER"
    if not people.address:
        raise InputError(f"{people.name}: no address of the single files is known; {by_hand}")
    try:
        import pooch
    except ImportError:
        raise InputError(
            f"{people.name}: downloads need the package pooch; install it with `pip install "
            f"pooch`, or {by_hand}"
        ) from None
    for file in lacking:
        try:
            pooch.retrieve(people.address + file.name, f"sha256:{file.digest}", file.name, folder)
        except (OSError, ValueError) as error:  # those of the network are of the first kind
            raise InputError(
                f"{people.name}: {file.name} cannot be downloaded ({error}); {by_hand}"
            ) from error
