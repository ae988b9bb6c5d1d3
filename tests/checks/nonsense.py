"""Nonsense planted in simulated recordings is named, and sound recordings are left in peace.

    nox -s check -- nonsense [--recordings 200]

Every kind of nonsense is planted in as many recordings of `nominal`; false alarms are counted
on as many of every scenario without a violation, and on the recordings of human pilots that
PILOTID_MEASURED names.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.datasets import POPULATIONS, SCENARIOS, simulate
from pilotid.estimates.method import identify
from pilotid.methods import method_named
from pilotid.recordings.checks import remarks
from pilotid.recordings.files import load_recording
from pilotid.recordings.recording import Recording

SOUND = {
    name: scenario
    for name, scenario in SCENARIOS.items()
    if scenario.violation is None and scenario.change is None
}
#: Target alone, where the sign of u follows from the slope of the element.
TARGET_ALONE = {"sign of u, no disturbance": "u has the wrong sign: x answers to -u"}
DRAWN = 100  # pilots of each population
ALL = ("e", "u", "x", "ft", "fd")


def delayed(recording: Recording, seconds: float) -> Recording:
    """The control recorded too late."""
    shift = round(seconds / recording.dt)
    u = recording.u
    return replace(recording, u=np.concatenate([u[:, :shift], u[:, :-shift]], axis=1))


def repeated(recording: Recording) -> Recording:
    """Two seconds of all signals recorded twice."""
    begin, length = recording.run_in + 1500, round(2.0 / recording.dt)

    def twice(signal: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
        return np.concatenate([signal[:, : begin + length], signal[:, begin:-length]], axis=1)

    return replace(recording, **{name: twice(getattr(recording, name)) for name in ALL})


def dropped(recording: Recording, names: tuple[str, ...]) -> Recording:
    """Twenty seconds lost."""
    begin, length = recording.run_in + 1000, round(20.0 / recording.dt)
    changed = {name: getattr(recording, name).copy() for name in names}
    for signal in changed.values():
        signal[:, begin : begin + length] = 0.0
    return replace(recording, **changed)


def spoilt(recording: Recording) -> Recording:
    """One sample holds a code for a missing value."""
    u = recording.u.copy()
    u[0, recording.run_in + 777] = -9999.0
    return replace(recording, u=u)


def clipped(recording: Recording) -> Recording:
    """A control that saturates almost always."""
    return replace(recording, u=np.clip(recording.u, *np.quantile(recording.u, (0.45, 0.55))))


def in_one_run(recording: Recording, change: Callable[[Recording], Recording]) -> Recording:
    """The recording with three more runs like it, and a change in the third of them."""
    runs = [simulate(SCENARIOS["nominal"], np.random.default_rng([9, i])) for i in range(3)]
    runs = [recording, runs[0], change(runs[1]), runs[2]]
    signals = {name: np.concatenate([getattr(r, name) for r in runs]) for name in ALL}
    return replace(recording, **signals)


def other_pilot(recording: Recording) -> Recording:
    """The control and nothing else of another run."""
    other = simulate(
        SCENARIOS["nominal"], np.random.default_rng([5, int(1e9 * recording.u[0, 9] ** 2)])
    )
    return replace(recording, u=other.u)


def deaf(recording: Recording) -> Recording:
    """A control that holds remnant alone."""
    rng = np.random.default_rng(int(1e9 * recording.u[0, 9] ** 2))
    noise = rng.standard_normal((1, recording.u.shape[1] + 24))
    smooth = np.lib.stride_tricks.sliding_window_view(noise, 25, axis=1).mean(axis=2)
    return replace(recording, u=smooth)


def without(recording: Recording, *names: str) -> Recording:
    """The recording as a laboratory has it that did not record some forcing functions."""
    return replace(recording, lines={}, **dict.fromkeys(names))


#: What may be wrong with the signals, and a word of the remark that must name it.
PLANTED: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "two seconds repeated": (repeated, "comes again"),
    "20 s of u lost": (lambda r: dropped(r, ("u",)), "keeps one value"),
    "20 s of all signals lost": (lambda r: dropped(r, ALL), "keeps one value"),
    "a missing-value code": (spoilt, "a code for a missing value"),
    "u clipped": (clipped, "clipped"),
    "u drifts": (lambda r: replace(r, u=r.u + 0.01 * r.time), "drifts"),
    "u has an offset": (lambda r: replace(r, u=r.u + 0.4 * np.std(r.u)), "u has an offset"),
    "u late by 1 s": (lambda r: delayed(r, 1.0), "s after x has answered"),
    "sign of e": (lambda r: replace(r, e=-r.e), "e has the wrong sign"),
    "sign of x": (lambda r: replace(r, x=-r.x), "x has the wrong sign"),
    "e and x exchanged": (lambda r: replace(r, e=r.x, x=r.e), "exchanged"),
    "x in radians": (lambda r: replace(r, x=np.deg2rad(r.x)), "e is not ft - x"),
    "x in radians, no target": (
        lambda r: replace(without(r, "ft"), x=np.deg2rad(r.x)),
        "x is in radians",
    ),
    "e in millimetres": (lambda r: replace(r, e=1000.0 * r.e), "e is 1000 times what the others"),
    "sign of e, no target": (lambda r: replace(without(r, "ft"), e=-r.e), "e and x have the same"),
    "sign of u": (lambda r: replace(r, u=-r.u), "u has the wrong sign: x answers to fd - u"),
    "sign of u, no target": (lambda r: replace(without(r, "ft"), u=-r.u), "u has the wrong sign"),
    "sign of fd": (lambda r: replace(r, fd=-r.fd), "fd has the wrong sign"),
    "signs of u and fd": (lambda r: replace(r, u=-r.u, fd=-r.fd), "u and fd have the wrong sign"),
    "u of another run": (other_pilot, "x is not the answer to u"),
    "sign of u in one run": (
        lambda r: in_one_run(r, lambda r: replace(r, u=-r.u)),
        "u has the wrong sign in run 3",
    ),
    "x and e tripled in one run": (
        lambda r: in_one_run(r, lambda r: replace(r, e=3.0 * r.e, x=3.0 * r.x, ft=3.0 * r.ft)),
        "element of run 3 differs",
    ),
    "one run three times as large": (
        lambda r: in_one_run(r, lambda r: replace(r, **{n: 3.0 * getattr(r, n) for n in ALL})),
        "of run 3 is",
    ),
    "u without the forcing": (deaf, "answer"),
    "e is zero": (lambda r: replace(r, e=0.0 * r.e), "e does not move"),
    "x is zero": (lambda r: replace(r, x=0.0 * r.x), "x does not move"),
}
#: What only an estimate shows.
LATE = {"u late by 10 s": 10.0}


def drawn(population: Any, number: int) -> Recording:
    """The recording of one pilot of a population."""
    rng = np.random.default_rng(number)
    return simulate(population.drawn(rng), rng)


def named(recording: Recording, word: str) -> bool:
    """Whether a remark on the recording has the word."""
    return any(word in remark for remark in remarks(recording))


def named_by_a_fit(recording: Recording) -> bool:
    """Whether `mle` says that it explains nothing, or fails."""
    model = SCENARIOS["nominal"].model
    estimate = identify(method_named("mle"), recording, model, np.random.default_rng(1))
    told = any("explains" in remark for remark in estimate.remarks)
    return told or not estimate.outcome.usable


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=200)
    count = parser.parse_args().recordings
    nominal = SCENARIOS["nominal"]
    for what, (plant, word) in PLANTED.items():
        hits = sum(
            named(plant(simulate(nominal, np.random.default_rng(i))), word) for i in range(count)
        )
        print(f"{what:30} named in {hits} of {count}")
    for what, word in TARGET_ALONE.items():
        alone = SCENARIOS["target-only"]
        recordings = (simulate(alone, np.random.default_rng(i)) for i in range(count))
        hits = sum(named(replace(without(r, "fd"), u=-r.u), word) for r in recordings)
        print(f"{what:30} named in {hits} of {count}")
    for what, seconds in LATE.items():
        hits = sum(
            named_by_a_fit(delayed(simulate(nominal, np.random.default_rng(i)), seconds))
            for i in range(count)
        )
        print(f"{what:30} named in {hits} of {count}")
    false = {
        name: sum(bool(remarks(simulate(scenario, np.random.default_rng(i)))) for i in range(count))
        for name, scenario in SOUND.items()
    }
    worst = {name: alarms for name, alarms in false.items() if alarms} or "none"
    print(f"false alarms on {count} recordings of each of {len(false)} scenarios: {worst}")
    for name, population in POPULATIONS.items():
        for how in ((), ("ft",), ("fd",)):
            alarms = Counter(
                sentence
                for i in range(DRAWN)
                for sentence in remarks(without(drawn(population, i), *how))
            )
            words = f" without {' and '.join(how)}" if how else ""
            print(f"false alarms on {DRAWN} of {name}{words}: {dict(alarms) or 'none'}")
    if folder := os.environ.get("PILOTID_MEASURED"):
        files = [*Path(folder).glob("*/*.mat"), *Path(folder).glob("rollpitch/pilot*.csv")]
        alarms = {f.name: found for f in sorted(files) if (found := remarks(load_recording(f)))}
        print(f"false alarms on {len(files)} recordings of human pilots: {alarms or 'none'}")


if __name__ == "__main__":
    main()
