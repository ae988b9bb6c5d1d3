"""The controlled element that a recording shows: identified from u, fd and x.

x = Hc (u + fd) holds in the recording almost without noise, so that a few forms of low order are
fitted to windowed spectra (`pilotid.checks.element_forms`) of all runs at once.  The
simplest that describes the recording is taken: one that leaves less of x than anyone would
notice, or else the one of the smallest Bayesian information criterion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pilotid.checks.detectors import findings
from pilotid.checks.element_forms import OMEGA, FormFit, drive_of, fits_of, simplest, spectra_of
from pilotid.model.element import ControlledElement, as_element, element_named, parsed_element
from pilotid.recording.recording import Recording, remembered
from pilotid.support.limits import ELEMENT
from pilotid.support.remarks import Remark
from pilotid.support.types import FloatArray

#: A controlled element as users give it: itself, its text, or nothing.
GivenElement = ControlledElement | str | None
#: Origins of an element, and their words.
GIVEN, FILE, SIGNALS = "given", "recording", "identified"
ORIGINS = {
    GIVEN: "as given",
    FILE: "named by the recording",
    SIGNALS: "identified from the signals",
}


@dataclass(frozen=True, eq=False)
class ElementChoice:
    """A controlled element, such as loops are drawn with.

    Attributes
    ----------
    element
        None if none is known.
    origin
        ``given``, named by the ``recording``, or ``identified`` from its signals.
    why
        Why none is known, or what speaks against it, in a sentence; empty if nothing does.
    remarks
        Where what is said of it and what signals show disagree, a sentence each.
    left
        Share of the amplitude of x that it does not explain where loops cross over.
    """

    element: ControlledElement | None = None
    origin: str = ""
    why: str = ""
    remarks: tuple[Remark, ...] = ()
    left: float = 0.0

    def named_in(self, recording: Recording) -> Recording:
        """The recording, naming the element that was given, for methods that need the loop."""
        if self.origin != GIVEN or self.element is None:
            return recording
        return replace(recording, controlled_element=self.element.name)

    @property
    def words(self) -> str:
        """The element and where it comes from."""
        if self.element is None:
            return self.why
        name = self.element.name or "user-defined"
        return f"loops with the controlled element {name}, {ORIGINS[self.origin]}"


@remembered
def identified_element(recording: Recording) -> ElementChoice:
    """The controlled element that u, fd and x show, with numbers rounded to their errors.

    It has a name that `element_named` reads.
    """
    for name, signal in (("x", recording.x), ("u + fd", drive_of(recording))):
        if not np.ptp(recording.window(signal), axis=1).any():
            absent = name == "x" and "x" not in recording.signals
            return ElementChoice(why=f"{name} {'was not recorded' if absent else 'does not move'}")
    fits = fits_of(recording)
    if not fits:
        return ElementChoice(why="no form of element suits control and output")
    chosen = simplest([fit for fit in fits if _is_steerable(fit)] or fits)
    if not _is_steerable(chosen, ELEMENT.slowest_pole):
        # Drift of x makes slow unstable poles, which explain no more where loops cross over.
        most = 1.5 * (100.0 - chosen.explained)
        near = [f for f in fits if f.form.size <= chosen.form.size and 100.0 - f.explained <= most]
        chosen = simplest([f for f in near if _is_steerable(f, ELEMENT.slowest_pole)] or [chosen])
    element = element_named(chosen.form.name(rounded(chosen.values, chosen.covariance)))
    left = math.sqrt(1.0 - 0.01 * chosen.explained)
    why = _against(element, chosen, left, recording.fd is not None)
    return ElementChoice(element, SIGNALS, why, left=left)


def _is_steerable(fit: FormFit, slowest_pole: float = 0.0) -> bool:
    """Whether people can keep a loop with the element stable, with no slower unstable pole [rad/s].

    With a zero z and a pole p in the right half-plane the sensitivity is at least
    (z + p)/|z - p| somewhere, and its complement e^(p delay) with a delay (Skogestad &
    Postlethwaite, *Multivariable Feedback Control*, ch. 5); where noise is fitted zero and pole are
    nearly one.
    """
    every = (np.roots(polynomial) for polynomial in fit.form.polynomials(fit.values))
    zero, pole = (roots.real[roots.real > 0.0] for roots in every)
    if np.any(zero < ELEMENT.slowest_zero):
        return False
    if np.any((pole < slowest_pole) | (pole > ELEMENT.fastest_pole)):
        return False
    if np.any(pole * fit.values[-1] > math.log(ELEMENT.sensitivity)):
        return False
    z, p = np.meshgrid(zero, pole)
    return bool(np.all(z + p <= ELEMENT.sensitivity * np.abs(z - p)))


def rounded(values: FloatArray, covariance: FloatArray) -> FloatArray:
    """Each number as short as its error allows, the others held; the last, a delay, or none."""
    held = 1.0 / np.sqrt(np.diag(np.linalg.inv(covariance)))
    every = [_short(*pair) for pair in zip(values.tolist(), held.tolist(), strict=True)]
    # An offset between the recorder's channels, which may be negative, is no part of the element.
    return np.array([*every[:-1], every[-1] if values[-1] > held[-1] else 0.0])


def _short(value: float, error: float) -> float:
    """The shortest number within an error."""
    every = (float(f"{value:.{digits}g}") for digits in range(1, 9))
    return next((short for short in every if abs(short - value) <= error), value)


def _against(element: ControlledElement, fit: FormFit, left: float, is_forced: bool) -> str:
    """What speaks against an identified element, in a sentence; empty if nothing does."""
    if left > ELEMENT.unexplained:
        missing = "perhaps another" if is_forced else "most often a"
        return (
            "control and output follow no one controlled element of low order: the best, "
            f"{element.name}, leaves about {100.0 * left:.0f} % of the amplitude of x; {missing} "
            "disturbance was not recorded, or the element changes within a run, a signal is late, "
            "or a name, a unit or a sign is wrong"
        )
    if (delay := float(fit.values[-1])) < -ELEMENT.late:
        return (
            f"x seems to answer {1e3 * -delay:.0f} ms before u moves, as {element.name} would: "
            "u is late, or has noise in it that did not reach the element"
        )
    if (error := float(fit.error_at(OMEGA).max())) > ELEMENT.known:
        return (
            f"control and output tell the controlled element, {element.name}, to within "
            f"{100.0 * error:.0f} % only where loops cross over"
        )
    top, bottom = (np.trim_zeros(np.array(p)) for p in (element.numerator, element.denominator))
    if top[0] * bottom[0] < 0.0 and top[-1] * bottom[-1] < 0.0:
        return (
            f"control and output follow {element.name}, whose gain is negative: u or x "
            "seems to have the wrong sign"
        )
    return ""


@remembered
def confirmed_element(recording: Recording) -> ControlledElement | None:
    """The element that the file names, where its signals follow it closely; else None."""
    named = parsed_element(recording.controlled_element)
    if named is None:
        return None
    with np.errstate(all="ignore"):  # signals that do not move, which tell nothing
        left = spectra_of(recording).unexplained(named)
    return named if left <= 0.5 * ELEMENT.different else None


def unexplained(recording: Recording) -> Remark | None:
    """A doubt where x is the answer to u + fd by no element of low order."""
    if recording.fd is None or confirmed_element(recording):
        return None
    choice = identified_element(recording)
    is_left = choice.left > ELEMENT.unexplained
    return Remark("output-unrelated", choice.why, "doubt") if is_left else None


def chosen_element(recording: Recording, given: GivenElement = None) -> ElementChoice:
    """The element that the user gives, else that the file names, else that its signals show.

    Parameters
    ----------
    recording
        The recording.
    given
        The user's element, or its text, if any.
    """
    if not given and (confirmed := confirmed_element(recording)):
        return ElementChoice(confirmed, FILE)  # to ask signals for a form takes long
    named = parsed_element(recording.controlled_element)
    identified = identified_element(recording)
    fault = next((f for f in findings(recording) if f.grade != "note" and not f.is_turned), None)
    shifted = fault and fault.code == "late-signal" and abs(fault.size) > ELEMENT.late
    shown = None if identified.why or shifted else identified.element
    stated = ElementChoice(as_element(given), GIVEN) if given else ElementChoice(named, FILE)
    if stated.element is None:
        why = fault.sentence if fault else f"{identified.why}; name it, for example --element 4/s^2"
        choice = identified if shown else ElementChoice(why=f"no loops: {why}")
        text = recording.controlled_element.strip()
        words = (
            f"the file calls the controlled element {text!r:.50}, which is none; write 4/s^2 or so"
        )
        return replace(choice, remarks=(Remark("element-differs", words, "note"),) * bool(text))
    what = "given" if given else "that the file names"
    other, by = shown, "control and output of the recording follow"
    if given and shown is None:
        other, by = named, "the file names"
    remark = differs(stated.element, other, what, by) if other else None
    return replace(stated, remarks=(remark,) if remark else ())


def differs(
    given: ControlledElement, other: ControlledElement, what: str, by: str
) -> Remark | None:
    """Say that two controlled elements are different ones; None if they are not.

    Parameters
    ----------
    given, other
        The element that someone states, and the one that it is compared with.
    what
        Which element the first is.
    by
        Where the second comes from, with its verb.
    """
    with np.errstate(all="ignore"):  # a pole or a zero may lie at one of them
        ratio = given.response(OMEGA) / other.response(OMEGA)
        if float(np.sqrt(np.mean(np.abs(ratio - 1.0) ** 2))) <= ELEMENT.different:
            return None
    return Remark(
        "element-differs",
        f"the controlled element {what} is {given.name or 'another'}, but {by} "
        f"{other.name or 'another'}; margins with the wrong one mislead",
    )


@remembered
def closing_element(recording: Recording) -> ControlledElement | None:
    """The controlled element that closes the loop of a recording.

    The one that the recording names, unless its signals show another one; None if none is known.
    """
    choice = chosen_element(recording)
    doubted = choice.element and choice.remarks
    return identified_element(recording).element if doubted else choice.element
