"""What a method is, and running one."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Protocol

import numpy as np

from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.remarks import remarks_on
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording


class Method(Protocol):
    """An estimator: a frozen dataclass of settings, whose repr labels it in reports."""

    @property
    def name(self) -> str:
        """Name on the command line and in files."""
        ...

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why this method cannot treat the recording, or None."""
        ...

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Estimate the model's parameters; a fit that fails says so in its outcome."""
        ...


def identify(
    method: Method, recording: Recording, model: PilotModel, rng: np.random.Generator
) -> Estimate:
    """Run a method on a recording, with its objection heeded and its time taken."""
    import scipy.fft  # noqa: F401, before the fit is timed

    objection = method.objection(recording, model)
    if objection:
        return failed(method.name, model, Outcome.NOT_APPLICABLE, objection)
    begin = time.perf_counter()
    try:
        estimate = method.fit(recording, model, rng)
    except (np.linalg.LinAlgError, FloatingPointError) as error:
        estimate = failed(method.name, model, Outcome.SINGULAR, str(error))
    seconds = time.perf_counter() - begin
    return replace(estimate, seconds=seconds, remarks=remarks_on(estimate))
