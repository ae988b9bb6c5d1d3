"""A study's recordings as files for other languages, and the estimates that come back.

`export` writes the recordings that `pilotid compare` makes with the same seed, a manifest with a
digest of each, and the truth in a folder of its own.  `read_estimates` makes fits of a table of
estimates; it refuses those of other recordings than the study's.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pilotid.datasets import AnyScenario, scenarios_named
from pilotid.datasets.named import truth
from pilotid.estimate.estimate import Outcome
from pilotid.naming.settings import name_of
from pilotid.recording.files import save_recording
from pilotid.recording.recording import Recording
from pilotid.study.run import recorded, recording_of, scenario_of, started, with_truth
from pilotid.study.table import METHODS, Entry, Fit, Store
from pilotid.support.disk import make_folder, require_file, require_folder, strict_json, write_file
from pilotid.support.store import number
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

    from pilotid.study.study import Study

MANIFEST = "manifest.json"
RECORDINGS, TRUTH = "recordings", "truth"  # folders of an export
STEPS = 1e4  # of a signal's rms: finer than any estimate needs, coarser than rounding
LARGEST = 2**26  # bytes of a manifest or of a table of estimates
NUMBERS = ("value", "std_error", "lower", "upper")
#: Columns of a table of estimates that must be there.
REQUIRED = ("scenario", "replication", "parameter", "value")


@dataclass(frozen=True)
class Wanted:
    """A parameter to estimate: where all methods start, and between which bounds they search."""

    key: str
    unit: str
    start: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Exported:
    """A recording in a manifest.

    Attributes
    ----------
    file
        Its place in the folder.
    scenario, replication
        What it is a recording of, replications from 0.
    digest
        See `digest_of`.
    dt, run_in, runs
        Sampling interval [s], samples before the measurement window, number of runs.
    controlled_element
        Name of the controlled element, empty where methods have to do without.
    model
        Name of the pilot model to fit.
    parameters
        What to estimate, in the model's order.
    """

    file: str
    scenario: str
    replication: int
    digest: str
    dt: float
    run_in: int
    runs: int
    controlled_element: str
    model: str
    parameters: tuple[Wanted, ...]


@dataclass(frozen=True)
class Manifest:
    """What an export holds.

    Attributes
    ----------
    about
        What the parts mean, in words.
    seed
        Seed of all random numbers, as for `pilotid compare --seed`.
    scenarios
        What the command line takes for them.
    replications
        Recordings of each scenario.
    recordings
        All of them.
    """

    about: dict[str, str]
    seed: int
    scenarios: tuple[str, ...]
    replications: int
    recordings: tuple[Exported, ...]


ABOUT = {
    "recordings": "t: time [s], negative in the run-in, which is not to be scored; e: error; u: "
    "control; x: response of the controlled element; ft: target; fd: disturbance; runs are columns",
    "estimates": "a CSV in this folder, with the columns scenario, replication, parameter, value "
    "and if known std_error, lower, upper (95 %), seconds, method",
    "truth": "the true parameters, which no method may read",
}


def export(
    scenarios: Sequence[str],
    replications: int,
    seed: int,
    folder: Path,
    kind: str,
    *,
    force: bool = False,
) -> Manifest:
    """Write the recordings of a study, and give their manifest.

    Parameters
    ----------
    scenarios
        What the command line takes for scenarios.
    replications, seed
        As for `pilotid.study.study.Study`.
    folder, kind
        Where to, and the format of the recordings: csv, mat or npz.
    force
        Whether an export that is there is written over.
    """
    require_folder(folder, [MANIFEST], force=force)
    make_folder(folder / RECORDINGS)
    make_folder(folder / TRUTH)
    made = []
    for origin in [own for text in scenarios for own in scenarios_named(text)]:
        for replication in range(replications):
            scenario = scenario_of(origin, seed, replication)
            recording = recording_of(origin, seed, recorded(origin, replication))
            model = started(scenario, seed, replication)
            name = f"{name_of(origin.name)}-{replication}"
            file = f"{RECORDINGS}/{name}.{kind}"
            save_recording(recording, folder / file)
            told = strict_json({"seed": seed, "replication": replication, **truth(scenario)})
            write_file(folder / TRUTH / f"{name}.json", told.encode())
            wanted = tuple(
                Wanted(p.key, p.unit, float(start), p.lower, p.upper)
                for p, start in zip(model.parameters, model.start, strict=True)
            )
            key = origin.name, replication, digest_of(recording)
            signals = recording.dt, recording.run_in, recording.runs
            element = recording.controlled_element
            made.append(Exported(file, *key, *signals, element, model.name, wanted))
    manifest = Manifest(ABOUT, seed, tuple(scenarios), replications, tuple(made))
    write_file(folder / MANIFEST, strict_json(asdict(manifest)).encode())
    return manifest


def digest_of(recording: Recording) -> str:
    """SHA-256 of all signals in steps of 1e-4 of their rms, the same on every processor."""
    digest = hashlib.sha256()
    for name in recording.signals:
        signal = recording.arrays[name]
        size = math.sqrt(float(np.mean(signal**2))) or 1.0
        digest.update(np.rint(STEPS / size * signal).astype("<i4").tobytes())
    return digest.hexdigest()


def read_manifest(estimates: Path) -> Manifest:
    """The manifest beside a table of estimates.

    Raises
    ------
    InputError
        If there is none.
    """
    from pydantic import TypeAdapter

    path = estimates.parent / MANIFEST
    if not path.is_file():
        raise InputError(
            f"{estimates}: there is no {MANIFEST} beside it; put it into the folder that `pilotid "
            "export` wrote"
        )
    require_file(path, LARGEST)
    try:
        manifest: Manifest = TypeAdapter(Manifest).validate_json(path.read_bytes())
    except (OSError, ValueError) as error:
        why = str(error).splitlines()[0]
        raise InputError(f"{path}: is no manifest ({why}); export the recordings again") from None
    return manifest


def read_estimates(path: Path, manifest: Manifest, study: Study) -> list[tuple[Entry, list[Fit]]]:
    """The methods of a table of estimates, with a fit for each recording of the study.

    A recording without an estimate, or with one that makes no sense, is a fit that failed; a
    method without any estimate of a scenario is not tried there.

    Parameters
    ----------
    path
        A CSV file with the columns scenario, replication, parameter and value, and if known
        std_error, lower and upper (ends of the 95 % interval), seconds, and method, which else is
        the file's name.
    manifest
        That of the recordings.
    study
        The study that they are to be part of.

    Raises
    ------
    InputError
        If the table cannot be read, or is of other recordings than the study's.
    """
    table, origins = _table(path), {scenario.name: scenario for scenario in study.scenarios}
    if manifest.seed != study.seed:
        raise InputError(
            f"{path}: its recordings have the seed {manifest.seed}, the study has {study.seed}; "
            f"say --seed {manifest.seed}"
        )
    known = {(own.scenario, own.replication): own for own in manifest.recordings}
    _require_known(path, table, known, origins)
    _require_same(path, {key for key in known if key[0] in origins}, known, origins, study)
    code = hashlib.sha256(path.read_bytes()).hexdigest()
    found = []
    for place, (label, own) in enumerate(table.groupby("method", sort=False)):
        if label in study.labels:
            raise InputError(f"{path}: a method of the study is called '{label}'; rename one")
        entry = Entry(
            str(label), 1000 + place, {"estimates": path.name}, code, f"--estimates {path}"
        )
        found.append((entry, list(_fits(path, own, origins, study))))
    return found


def enter_estimates(store: Store, found: Sequence[tuple[Entry, list[Fit]]]) -> None:
    """Keep methods and fits in a study's store, in place of what they were before.

    Raises
    ------
    InputError
        If a method that `pilotid` ran has the same label.
    """
    held = store.entries(METHODS)
    for entry, fits in found:
        before = held.get(entry.name)
        if before is not None and "estimates" not in before.settings:
            raise InputError(
                f"{store.path}: holds another method called '{entry.name}'; rename yours"
            )
        store.drop([("", entry.name, 0), *(f.key for f in store.fits() if f.method == entry.name)])
        store.enter(methods=[entry])
        for fit in fits:
            store.add(fit)


def _table(path: Path) -> DataFrame:
    """The table of estimates: numbers are numbers, NaN where there are none."""
    from pandas import read_csv, to_numeric

    require_file(path, LARGEST)
    try:
        table = read_csv(path, dtype=str, keep_default_na=False, skipinitialspace=True)
    except (OSError, ValueError) as error:
        why = str(error).splitlines()[0]
        raise InputError(f"{path}: cannot be read as CSV ({why}); write it again") from None
    table.columns = [str(name).strip("\ufeff ") for name in table.columns]
    lacking = [name for name in REQUIRED if name not in table]
    if lacking:
        raise InputError(f"{path}: has no column {lacking[0]}; it needs {', '.join(REQUIRED)}")
    if "method" not in table:
        table["method"] = name_of(path.stem)
    for name in (*NUMBERS, "seconds", "replication"):
        texts = table[name].str.strip() if name in table else ""
        table[name] = texts
        numbers = to_numeric(table[name], errors="coerce").astype(float)
        wrong = numbers.isna() & ~table[name].str.lower().isin(["", "nan", "na"])
        wrong |= np.isinf(numbers) | ((numbers % 1 != 0) & (name == "replication"))
        if wrong.any():
            row = int(np.argmax(wrong.to_numpy()))
            raise InputError(
                f"{path}, line {row + 2}: {name} '{table[name][row]:.30}' is no number; leave it "
                "empty where there is none"
            )
        table[name] = numbers
    for name in ("method", "scenario", "parameter"):
        table[name] = table[name].str.strip()
    twice = table.duplicated(["method", "scenario", "replication", "parameter"])
    if twice.any():
        row = int(np.argmax(twice.to_numpy()))
        raise InputError(
            f"{path}, line {row + 2}: {table.parameter[row]} of replication "
            f"{table.replication[row]:g} of {table.scenario[row]} is there twice; leave one out"
        )
    return table.astype({"replication": int})


def _require_known(
    path: Path,
    table: DataFrame,
    known: Mapping[tuple[str, int], Exported],
    origins: Mapping[str, AnyScenario],
) -> None:
    """Refuse estimates of anything that was not exported, or is not in the study."""
    columns = zip(table.scenario, table.replication, table.parameter, strict=True)
    for row, (name, replication, key) in enumerate(columns):
        own, what = known.get((name, replication)), ""
        if name not in origins:
            what = f"scenario '{name:.50}' is not in the study; it has {', '.join(origins)}"
        elif own is None:
            what = f"{MANIFEST} has no replication {replication} of scenario {name}"
        elif key not in (keys := [wanted.key for wanted in own.parameters]):
            what = f"model {own.model} has no parameter '{key:.50}'; it has {', '.join(keys)}"
        if what:
            raise InputError(f"{path}, line {row + 2}: {what}")


def _require_same(
    path: Path,
    keys: set[tuple[str, int]],
    known: Mapping[tuple[str, int], Exported],
    origins: Mapping[str, AnyScenario],
    study: Study,
) -> None:
    """Refuse estimates unless all recordings of the study are those that were exported."""
    for name, origin in origins.items():
        exported = [replication for own, replication in keys if own == name]
        if exported and len(exported) < study.replications:
            raise InputError(
                f"{path}: {len(exported)} recordings of {name} were exported, the study has "
                f"{study.replications}; say --replications {len(exported)}"
            )
        for replication in sorted(exported)[: study.replications]:
            recording = recording_of(origin, study.seed, recorded(origin, replication))
            if digest_of(recording) != known[name, replication].digest:
                raise InputError(
                    f"{path.parent / MANIFEST}: replication {replication} of {name} has another "
                    "digest than the study's recording; export and fit the recordings again"
                )


def _fits(
    path: Path, table: DataFrame, origins: Mapping[str, AnyScenario], study: Study
) -> Iterator[Fit]:
    """A fit by one method for each recording of the scenarios that it was tried on."""
    label = str(table.method.iloc[0])
    rows = dict(iter(table.groupby(["scenario", "replication"], sort=False)))
    for name in table.scenario.unique():
        for replication in range(study.replications):
            scenario = scenario_of(origins[name], study.seed, replication)
            own = rows.get((name, replication), table[:0])
            found = {key: values for key, *values in own[["parameter", *NUMBERS]].itertuples(False)}
            why = _fault(found, scenario.model.keys)
            outcome = Outcome.INVALID if why else Outcome.CONVERGED
            seconds = number(own.seconds.iloc[0]) if len(own) else None
            fit = Fit(name, label, replication, outcome.slug, why, not why, seconds=seconds)
            yield with_truth(fit, scenario, {} if why else found)


def _fault(found: Mapping[str, Sequence[float]], keys: Sequence[str]) -> str:
    """Why the estimates of a recording are no result, empty if they are."""
    if not found:
        return "there is no estimate of this recording"
    for key in keys:
        value, error, low, high = found.get(key, (math.nan,) * 4)
        if math.isnan(value):
            return f"there is no value of {key}"
        if error <= 0.0:
            return f"the standard error of {key} is not positive"
        if low > value or high < value:
            return f"the interval of {key} does not hold its value"
    return ""
