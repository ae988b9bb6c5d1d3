"""A study's recordings as files for other languages, and the estimates that come back.

`export` writes the recordings that `pilotid compare` makes with the same seed, a manifest with a
digest of each, and the truth in a folder of its own.  `read_estimates` makes fits of a table of
estimates; it refuses those of other recordings than the study's.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pilotid.datasets import scenario_named
from pilotid.datasets.named import truth
from pilotid.estimate.estimate import Outcome
from pilotid.recording.files import save_recording
from pilotid.recording.recording import Recording
from pilotid.study.run import recorded, recording_of, scenario_of, started, with_truth
from pilotid.study.table import OF_METHODS, Entry, Fit, Store
from pilotid.support.disk import make_folder, require_file, require_folder, strict_json, write_file
from pilotid.support.naming import name_of
from pilotid.support.store import number
from pilotid.support.types import InputError, reason

if TYPE_CHECKING:
    from pandas import DataFrame

    from pilotid.study.study import Study

MANIFEST = "manifest.json"
RECORDINGS, TRUTH = "recordings", "truth"  # folders of an export
STEPS_PER_RMS = 1e4  # of a signal's rms: finer than any estimate needs, coarser than rounding
NUMBERS = ("value", "std_error", "lower", "upper")
#: Columns of a table of estimates that must be there.
REQUIRED = ("scenario", "replication", "parameter", "value")
ABOUT = {
    "recordings": "t: time [s], negative in the run-in, which is not to be scored; e: error; u: "
    "control; x: response of the controlled element; ft: target; fd: disturbance; runs are columns",
    "estimates": "a CSV in this folder, with the columns scenario, replication, parameter, value "
    "and if known std_error, lower, upper (95 %), seconds, method",
    "truth": "the true parameters, which no method may read",
}


class Manifest(NamedTuple):
    """What makes the recordings of an export again, and their digests.

    Attributes
    ----------
    seed, scenarios, replications
        As for `pilotid compare`.
    digests
        By scenario and replication, see `digest_of`.
    """

    seed: int
    scenarios: tuple[str, ...]
    replications: int
    digests: Mapping[tuple[str, int], str]


def export(
    scenarios: Sequence[str],
    replications: int,
    seed: int,
    folder: Path,
    kind: str,
) -> int:
    """Write the recordings of a study, their manifest and their truth; returns how many there are.

    The manifest has for each recording its file, sampling interval ``dt`` [s], samples of run-in,
    runs, controlled element (empty where methods do without), and the model to fit with start and
    bounds of each parameter.

    Parameters
    ----------
    scenarios
        What the command line takes for scenarios.
    replications, seed
        As for `pilotid.study.study.Study`.
    folder, kind
        Where to, and the format of the recordings: csv, mat or npz.
    """
    require_folder(folder, [MANIFEST])
    make_folder(folder / RECORDINGS)
    make_folder(folder / TRUTH)
    entries = []
    for origin in [scenario_named(text) for text in scenarios]:
        for replication in range(replications):
            scenario = scenario_of(origin, seed, replication)
            recording = recording_of(origin, seed, recorded(origin, replication))
            model = started(scenario, seed, replication)
            name = f"{name_of(origin.name)}-{replication}"
            file = f"{RECORDINGS}/{name}.{kind}"
            save_recording(recording, folder / file)
            known = {"seed": seed, "replication": replication, **truth(scenario)}
            write_file(folder / TRUTH / f"{name}.json", strict_json(known).encode())
            entries.append({
                "file": file,
                "scenario": origin.name,
                "replication": replication,
                "digest": digest_of(recording),
                **{fact: getattr(recording, fact) for fact in ("dt", "run_in", "runs")},
                "controlled_element": recording.controlled_element,
                "model": model.name,
                "parameters": [
                    {"key": p.key, "unit": p.unit, "start": start, "lower": p.lower,
                     "upper": p.upper}
                    for p, start in zip(model.parameters, map(float, model.start), strict=True)
                ],
            })  # fmt: skip
    manifest = {"about": ABOUT, "seed": seed, "scenarios": [*scenarios]}
    manifest |= {"replications": replications, "recordings": entries}
    write_file(folder / MANIFEST, strict_json(manifest).encode())
    return len(entries)


def digest_of(recording: Recording) -> str:
    """SHA-256 of all signals in steps of 1e-4 of their rms, the same on every processor."""
    digest = hashlib.sha256()
    for name in recording.signals:
        signal = recording.arrays[name]
        size = math.sqrt(float(np.mean(signal**2))) or 1.0
        digest.update(np.rint(STEPS_PER_RMS / size * signal).astype("<i4").tobytes())
    return digest.hexdigest()


def read_manifest(estimates: Path) -> Manifest:
    """The manifest beside a table of estimates.

    Raises
    ------
    InputError
        If there is none.
    """
    path = estimates.parent / MANIFEST
    if not path.is_file():
        raise InputError(
            f"{estimates}: there is no {MANIFEST} beside it; put it into the folder that `pilotid "
            "export` wrote"
        )
    try:
        made = json.loads(path.read_bytes())
        digests = {
            (row["scenario"], row["replication"]): row["digest"] for row in made["recordings"]
        }
        return Manifest(made["seed"], tuple(made["scenarios"]), made["replications"], digests)
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise InputError(
            f"{path}: is no manifest ({reason(error)}); export the recordings again"
        ) from None


def read_estimates(path: Path, study: Study) -> list[tuple[Entry, list[Fit]]]:
    """The methods of a table of estimates, with a fit for each recording of the study.

    A recording without an estimate, or with one that makes no sense, is a fit that failed; a
    method without any estimate of a scenario is not tried there.

    Parameters
    ----------
    path
        A CSV file with the columns scenario, replication, parameter and value, and if known
        std_error, lower and upper (ends of the 95 % interval), seconds, and method, which else is
        the file's name.
    study
        The study that they are to be part of.

    Raises
    ------
    InputError
        If the table cannot be read, or is of other recordings than the study's.
    """
    table, manifest = _table(path), read_manifest(path)
    if manifest.seed != study.seed:
        raise InputError(
            f"{path}: its recordings have the seed {manifest.seed}, the study has {study.seed}; "
            f"say --seed {manifest.seed}"
        )
    _require_same(path, table, manifest, study)
    code = hashlib.sha256(path.read_bytes()).hexdigest()
    entries = []
    for place, (label, rows) in enumerate(table.groupby("method", sort=False)):
        if label in study.labels:
            raise InputError(f"{path}: a method of the study is called '{label}'; rename one")
        entry = Entry(
            str(label), 1000 + place, {"estimates": path.name}, code, f"--estimates {path}"
        )
        entries.append((entry, list(_fits(rows, study))))
    return entries


def enter_estimates(store: Store, entries: Sequence[tuple[Entry, list[Fit]]]) -> None:
    """Keep methods and fits in a study's store, in place of what they were before.

    Raises
    ------
    InputError
        If a method that `pilotid` ran has the same label.
    """
    known = store.entries(OF_METHODS)
    for entry, fits in entries:
        before = known.get(entry.name)
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

    require_file(path)
    try:
        table = read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        why = str(error).splitlines()[0]
        raise InputError(f"{path}: cannot be read as CSV ({why}); write it again") from None
    table = table.rename(columns=str.strip).apply(lambda column: column.str.strip())
    if table.empty:
        raise InputError(f"{path}: holds no row of estimates; write one for each parameter")
    lacking = [name for name in REQUIRED if name not in table]
    if lacking:
        raise InputError(f"{path}: has no column {lacking[0]}; it needs {', '.join(REQUIRED)}")
    usual = {"method": name_of(path.stem), **dict.fromkeys((*NUMBERS, "seconds"), "")}
    table = table.assign(**{name: text for name, text in usual.items() if name not in table})
    for name in (*NUMBERS, "seconds", "replication"):
        numbers = to_numeric(table[name], errors="coerce").astype(float)
        wrong = numbers.isna() & ~table[name].str.lower().isin(["", "nan", "na"])
        wrong |= (numbers % 1 != 0) & (name == "replication")
        if wrong.any():
            row = int(np.argmax(wrong.to_numpy()))
            raise InputError(
                f"{path}, line {row + 2}: {name} '{table[name][row]:.30}' is no number; leave it "
                "empty where there is none"
            )
        table[name] = numbers.where(np.isfinite(numbers))  # what diverged is no estimate
    twice = table.duplicated(["method", "scenario", "replication", "parameter"])
    if twice.any():
        row = int(np.argmax(twice.to_numpy()))
        raise InputError(
            f"{path}, line {row + 2}: {table.parameter[row]} of replication "
            f"{table.replication[row]:g} of {table.scenario[row]} is there twice; leave one out"
        )
    return table.astype({"replication": int})


def _require_same(path: Path, table: DataFrame, manifest: Manifest, study: Study) -> None:
    """Refuse estimates of anything but the study's recordings, which were exported."""
    origins = {scenario.name: scenario for scenario in study.scenarios}
    columns = zip(table.scenario, table.replication, table.parameter, strict=True)
    for row, (name, replication, key) in enumerate(columns):
        what = ""
        if name not in origins:
            what = f"scenario '{name:.50}' is not in the study; it has {', '.join(origins)}"
        elif (name, replication) not in manifest.digests:
            what = f"{MANIFEST} has no replication {replication} of scenario {name}"
        else:
            model = scenario_of(origins[name], study.seed, replication).model
            if key not in model.keys:
                known = ", ".join(model.keys)
                what = f"model {model.name} has no parameter '{key:.50}'; it has {known}"
        if what:
            raise InputError(f"{path}, line {row + 2}: {what}")
    for (name, replication), digest in manifest.digests.items():
        if name not in origins or replication >= study.replications:
            continue
        if manifest.replications < study.replications:
            raise InputError(
                f"{path}: {manifest.replications} recordings of {name} were exported, the study "
                f"has {study.replications}; say --replications {manifest.replications}"
            )
        recording = recording_of(origins[name], study.seed, recorded(origins[name], replication))
        if digest_of(recording) != digest:
            raise InputError(
                f"{path.parent / MANIFEST}: replication {replication} of {name} has another "
                "digest than the study's recording; export and fit the recordings again"
            )


def _fits(table: DataFrame, study: Study) -> Iterator[Fit]:
    """A fit by one method for each recording of the scenarios that it was tried on."""
    label = str(table.method.iloc[0])
    by_place = dict(iter(table.groupby(["scenario", "replication"], sort=False)))
    for origin in (s for s in study.scenarios if s.name in {*table.scenario}):
        for replication in range(study.replications):
            scenario = scenario_of(origin, study.seed, replication)
            rows = by_place.get((origin.name, replication), table[:0])
            numbers = rows[["parameter", *NUMBERS]].itertuples(False)
            estimates = {key: values for key, *values in numbers}
            why = _fault(estimates, scenario.model.keys)
            outcome = Outcome.INVALID if why else Outcome.CONVERGED
            seconds = number(rows.seconds.iloc[0]) if len(rows) else None
            key = origin.name, label, replication
            fit = Fit(*key, outcome.slug, why, not why, seconds=seconds)
            yield with_truth(fit, scenario, {} if why else estimates)


def _fault(estimates: Mapping[str, Sequence[float]], keys: Sequence[str]) -> str:
    """Why the estimates of a recording are no result, empty if they are."""
    if not estimates:
        return "there is no estimate of this recording"
    for key in keys:
        value, error, low, high = estimates.get(key, (math.nan,) * 4)
        if math.isnan(value):
            return f"there is no value of {key}"
        if error <= 0.0:
            return f"the standard error of {key} is not positive"
        if low > value or high < value:
            return f"the interval of {key} does not hold its value"
    return ""
