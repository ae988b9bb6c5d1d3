"""What a method is, and running one."""

from __future__ import annotations

import math
import os
import re
import time
import traceback
from dataclasses import replace
from importlib import import_module
from typing import Protocol, runtime_checkable

import numpy as np

from pilotid.estimates.band import AnalysedBand
from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.remarks import NOTHING, remarks_on, vague
from pilotid.estimates.sound import fault_of
from pilotid.estimates.trajectory import DRAWS, times_of, trajectory_of
from pilotid.naming.code import reason
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import motionless
from pilotid.recordings.lines import NotMultisineError, forcing_lines
from pilotid.recordings.recording import INPUTS, Recording
from pilotid.remarks import Remark
from pilotid.types import ComplexArray, FloatArray, InputError, one_line

#: Standard deviation of a forcing function over that of another signal below which there is none.
SAME = 0.01

#: What to do where channels cannot be told apart.
REMEDY = "record with a target and a disturbance, or fit one channel"

#: The environment variable that asks for tracebacks of methods that raise.
TRACEBACK = "PILOTID_TRACEBACK"


class Method(Protocol):
    """An estimator: a frozen dataclass of settings, whose label names it in reports."""

    @property
    def name(self) -> str:
        """Name on the command line and in files."""
        ...

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why this method cannot treat the recording, or None.

        Parameters
        ----------
        recording, model
            As for `fit`.

        Returns
        -------
        str or None
            A sentence, which tables show; None if it can.
        """
        ...

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Estimate the model's parameters; a fit that fails says so in its outcome.

        Parameters
        ----------
        recording
            The recording; it is read-only, and all its runs are of one pilot.
        model
            The pilot model, whose parameters fix the order of all numbers.
        rng
            The source of every random number.

        Returns
        -------
        Estimate
        """
        ...


@runtime_checkable
class Searching(Protocol):
    """A method that searches for the optimum of a criterion, and can say what it missed.

    A study sets the end of a fit against that of a search from the truth; a fit never knows
    of it.
    """

    def criteria_from(
        self, recording: Recording, model: PilotModel, sets: FloatArray
    ) -> FloatArray:
        """The criteria that searches reach which start at each of these alone, shape (sets,).

        Parameters
        ----------
        recording, model
            As for `Method.fit`.
        sets
            Parameters in model order, shape (sets, parameters); whatever is chosen before a
            search, such as a band, is chosen as suits the first.
        """
        ...


def follows(method: Method) -> bool:
    """Whether a method is for pilots who change: its class says ``follows = True``.

    Of a constant pilot it tells nothing that others do not tell better, so that studies leave
    it out there unless it is asked for.
    """
    return bool(getattr(method, "follows", False))


def import_libraries(method: Method) -> None:
    """Import what a fit uses, so that its time has none of it: some take longer than the fit.

    A method's class may name what it imports where it is used, as ``libraries = ("pysindy",)``.
    """
    for library in ("scipy.special", *getattr(method, "libraries", ())):
        import_module(library)


def identify(
    method: Method, recording: Recording, model: PilotModel, rng: np.random.Generator
) -> Estimate:
    """Run a method on a recording, with its objection heeded and its time taken.

    Whatever the method does, the answer is an estimate: what it raises, and what it returns
    that makes no sense, are outcomes.  Only an interruption by the user passes through.
    """
    name, begin = method.name, None
    try:
        objection = motionless_input(recording, model) or method.objection(recording, model)
        if objection:
            why = one_line(str(objection))
            return failed(name, model, Outcome.NOT_APPLICABLE, why)
        import_libraries(method)
        begin = time.perf_counter()
        estimate = method.fit(recording, model, rng)
        fault = fault_of(estimate, model)
        if fault:
            estimate = failed(name, model, Outcome.INVALID, fault)
        estimate = _over_time(estimate, recording, rng)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # code of others may raise anything, SystemExit as well
        if os.environ.get(TRACEBACK):
            traceback.print_exc()
        estimate = failed(name, model, *_outcome_of(error))
    seconds = float("nan") if begin is None else time.perf_counter() - begin
    if estimate.band is None and estimate.outcome.usable:
        estimate = replace(estimate, band=_band_of(method, recording))
    return replace(
        estimate,
        message=one_line(estimate.message),
        remarks=all_remarks(estimate, recording),
        seconds=seconds,
    )


def _band_of(method: Method, recording: Recording) -> AnalysedBand:
    """The band that a method says it analyses; all frequencies if it says none."""
    highest, nyquist = getattr(method, "band", None), math.pi / recording.dt
    return AnalysedBand(min(float(highest), nyquist) if highest else nyquist)


def _over_time(estimate: Estimate, recording: Recording, rng: np.random.Generator) -> Estimate:
    """An estimate with its trajectory, where the model changes and the method gave none."""
    model = estimate.model
    if estimate.trajectory is not None or not (model.changes and estimate.outcome.usable):
        return estimate
    draws = estimate.draws
    trajectory = trajectory_of(
        model.over(recording.duration),
        estimate.values,
        estimate.covariance,
        estimate.intervals,
        times_of(recording.duration),
        rng,
        draws=None if draws is None else draws.equally_weighted(DRAWS)[:, : len(model.keys)],
    )
    return replace(estimate, trajectory=trajectory)


def motionless_input(recording: Recording, model: PilotModel) -> str | None:
    """Why no method can identify a model: one of its channels has nothing to act on."""
    for channel in model.channels:
        name = INPUTS[channel.input]
        if (
            _absent(recording, recording.input("target"), recording.e)
            if channel.input == "target"
            else motionless(recording, name)
        ):
            held = name in recording.signals or channel.input == "target"
            what = "does not move" if held else "is not recorded"
            return f"{name} {what}, so that the {channel.name} channel has no input"
    return None


def all_remarks(estimate: Estimate, recording: Recording) -> tuple[Remark, ...]:
    """What a user must know of an estimate, also for what the recording lacks."""
    low = estimate.outcome.usable and estimate.vaf < NOTHING
    found = remarks_on(estimate, explained_at_lines(recording, estimate) if low else None)
    if estimate.outcome is Outcome.NOT_APPLICABLE:
        return found
    # Without a target the likelihood can have two summits, which no claimed error shows.
    why = shared_signals if vague(estimate) else one_signal
    shared = why(recording, estimate.model)
    return (*found, Remark("shared-signals", shared)) if shared else found


def explained_at_lines(recording: Recording, estimate: Estimate) -> float | None:
    """Share of the control at the lines of the forcing functions that a model explains [%].

    None without lines, and for pilots who vary in time.
    """
    try:
        every = forcing_lines(recording)
    except NotMultisineError:
        return None
    if not every or estimate.model.changes:
        return None
    lines = np.unique(np.concatenate(list(every.values())))
    omega = 2.0 * np.pi / recording.duration * lines

    def at_lines(signal: FloatArray) -> ComplexArray:
        return np.asarray(np.fft.rfft(recording.window(signal))[:, lines])

    control = at_lines(recording.u)
    responses = estimate.model.response(omega, estimate.values)
    left = control.copy()
    for channel, response in zip(estimate.model.channels, responses, strict=True):
        left -= channel.sign * response * at_lines(recording.input(channel.input))
    power = float(np.sum(np.abs(control) ** 2))
    return 100.0 * max(0.0, 1.0 - float(np.sum(np.abs(left) ** 2)) / power)


def shared_signals(recording: Recording, model: PilotModel) -> str | None:
    """Why channels can hardly be told apart: their signals depend on one another."""
    inputs = {channel.input for channel in model.channels}
    if "target" not in inputs or len(inputs) < 2:
        return one_signal(recording, model)
    if dependent := dependent_signals(model):
        return dependent
    names = " and ".join(channel.name for channel in model.channels)
    if recording.fd is not None and not _absent(recording, recording.fd, recording.u):
        return None
    return (
        f"no disturbance is recorded, and without one the {names} channels follow one signal: "
        f"nothing but their form and the remnant tells them apart; {REMEDY}"
    )


def dependent_signals(model: PilotModel) -> str | None:
    """Why no response of each channel can be measured: they act on e, x and ft, which is e + x."""
    if len({channel.input for channel in model.channels}) < 3:
        return None
    names = " and ".join(channel.name for channel in model.channels)
    return (
        f"ft = e + x, so that the {names} channels act on two signals: nothing but their form "
        "tells them apart; fit two channels"
    )


def varying(model: PilotModel) -> str | None:
    """Why a method of constant pilots cannot treat a model: its parameters vary in time."""
    if not model.changes:
        return None
    return (
        f"model {model.name} varies in time, and this method knows constant pilots alone; use mle, "
        "mle-white, mle-genetic or bayes, or fit a constant model"
    )


def one_signal(recording: Recording, model: PilotModel) -> str | None:
    """Why channels on error and output can hardly be told apart: there is no target."""
    if len({channel.input for channel in model.channels}) < 2:
        return None
    if not _absent(recording, recording.e + recording.x, recording.e):
        return None
    names = " and ".join(channel.name for channel in model.channels)
    return (
        f"there is no target, so that e = -x and the {names} channels act on one signal: only "
        f"what they do together is measured, and nothing but their form tells them apart; {REMEDY}"
    )


def _absent(recording: Recording, forcing: FloatArray, beside: FloatArray) -> bool:
    """Whether a forcing function is no more than rounding errors beside another signal."""
    size = np.std(recording.window(beside), axis=1)
    return not np.any(np.std(recording.window(forcing), axis=1) > SAME * size)


def _outcome_of(error: BaseException) -> tuple[Outcome, str]:
    """How a fit ended that raised an exception, and why."""
    match error:
        case np.linalg.LinAlgError() | FloatingPointError():
            return Outcome.SINGULAR, str(error)
        case MemoryError():
            return Outcome.OUT_OF_MEMORY, str(error)
        case InputError():  # a sentence already
            return Outcome.CRASHED, str(error)
        case _:
            return Outcome.CRASHED, reason(error)


def method_fault(thing: object) -> str:
    """Why a thing taken from code is no method, empty if it is one."""
    try:
        name = getattr(thing, "name", None)
    except Exception as error:
        return f"its name cannot be read ({reason(error)})"
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.+-]{0,60}", name, re.ASCII):
        return "a method needs a `name` of letters, digits and the signs . + -"
    lacking = [word for word in ("fit", "objection") if not callable(getattr(thing, word, None))]
    return f"a method needs a function `{lacking[0]}`" if lacking else ""
