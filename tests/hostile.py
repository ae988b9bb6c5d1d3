"""A method that misbehaves in every way that it is told."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording


def leave() -> None:
    sys.exit(3)


def fail() -> None:
    raise ValueError("a\udcffb\n\x1b[31mc\0")


def want_all_memory() -> None:
    np.ones(10**14)


def interrupt() -> None:
    raise KeyboardInterrupt


def vanish() -> None:
    os._exit(3)


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def hang() -> None:
    while True:
        try:
            time.sleep(1.0)
        except BaseException:
            continue


def shout() -> None:
    print("HELLO", flush=True)
    os.write(1, b"HELLO")


DEEDS: dict[str, Callable[[], None]] = {
    deed.__name__: deed
    for deed in (
        leave,
        fail,
        want_all_memory,
        interrupt,
        vanish,
        kill,
        hang,
        shout,
    )
}


def _answers(good: Estimate) -> dict[str, Any]:
    """What is returned in the place of a good estimate."""
    values, covariance = good.values, good.covariance
    return {
        "good": good,
        "nothing": None,
        "nan": replace(good, values=np.nan * values),
        "infinite": replace(good, covariance=np.full_like(covariance, np.inf)),
        "words": replace(good, values=values.astype(str)),
        "short": replace(good, values=values[:-1]),
        "flat": replace(good, intervals=good.intervals.ravel()),
        "negative": replace(good, covariance=-covariance),
        "reversed": replace(good, intervals=good.intervals[:, ::-1]),
        "bare": replace(good, intervals=np.full_like(good.intervals, np.nan)),
        "ends": replace(good, covariance=np.full_like(covariance, np.nan)),
        "partly": replace(good, intervals=np.where(values[:, None] > 0.2, good.intervals, np.nan)),
        "signs": replace(good, message="a\udcffb\n\x1b[31mc\0"),
    }


@dataclass(frozen=True)
class Hostile:
    """Does what it is told, or returns it."""

    how: str = "good"

    @property
    def name(self) -> str:
        return "hostile"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        if self.how == "objection":
            raise LookupError("no opinion")
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Any:
        if self.how in DEEDS:
            DEEDS[self.how]()
        if self.how == "spoil":
            recording.e.flags.writeable = True
            recording.e[:, 0] += 1.0
        values = model.start.copy()
        good = Estimate(
            self.name,
            model,
            Outcome.CONVERGED,
            values=values,
            covariance=np.diag((0.1 * values) ** 2),
            intervals=np.stack([0.8 * values, 1.2 * values], axis=1),
            vaf=50.0,
        )
        return _answers(good).get(self.how, good)
