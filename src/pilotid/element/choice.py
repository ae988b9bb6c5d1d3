"""Which controlled element loops are drawn with, and whether the recording agrees with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.element.fit import OMEGA, IdentifiedElement, identified_element
from pilotid.estimates.loop import LoopElement
from pilotid.pilot.element import ControlledElement, parsed_element
from pilotid.recordings.recording import Recording
from pilotid.remarks import Remark
from pilotid.types import FloatArray

#: Root mean square of the relative difference of two responses from which they are different
#: elements: a delay of a sample or two between the recorder's channels is less.
DIFFERENT = 0.1
#: Origins of an element.
GIVEN, FILE, SIGNALS = "given", "recording", "identified"


@dataclass(frozen=True, eq=False, kw_only=True)
class ElementChoice(LoopElement):
    """The controlled element to draw loops with, and what was held against it.

    Attributes
    ----------
    identified
        What u, fd and x say.
    """

    identified: IdentifiedElement


def chosen_element(recording: Recording, given: ControlledElement | None = None) -> ElementChoice:
    """The element that the user gives, else that the file names, else that its signals show.

    Parameters
    ----------
    recording
        The recording.
    given
        The user's element, if any.
    """
    found = identified_element(recording)
    named = parsed_element(recording.controlled_element)
    shown = found.element if found.sound else None
    remarks = []
    for element, what in ((given, "given"), (named, "that the file names")):
        sentence = differs(element, shown, OMEGA, what) if element and shown else None
        if sentence:
            remarks.append(sentence)
    if given and named and not shown:
        sentence = differs(given, named, OMEGA, by="the file names")
        remarks += [sentence] if sentence else []
    for element, origin in ((given, GIVEN), (named, FILE), (shown, SIGNALS)):
        if element is not None:
            return ElementChoice(element, origin, identified=found, remarks=tuple(remarks))
    why = f"no loops: {found.remark}; name the element, for example --element 4/s^2"
    return ElementChoice(why=why, identified=found, remarks=tuple(remarks))


def differs(
    given: ControlledElement,
    found: ControlledElement,
    omega: FloatArray = OMEGA,
    what: str = "given",
    by: str = "u, fd and x of the recording follow",
) -> Remark | None:
    """Say that two controlled elements are different ones; None if they are not.

    Parameters
    ----------
    given, found
        The element that someone states, and the one that is held against it.
    omega
        Frequencies at which they are compared [rad/s], shape (n,).
    what
        Which element the first is.
    by
        Where the second comes from, with its verb.
    """
    with np.errstate(all="ignore"):  # a pole or a zero may lie at one of them
        ratio = given.response(omega) / found.response(omega)
        if float(np.sqrt(np.mean(np.abs(ratio - 1.0) ** 2))) <= DIFFERENT:
            return None
    middle = int(np.argmin(np.abs(omega - 2.0)))
    gain, phase = np.abs(ratio[middle]), np.nan_to_num(np.angle(ratio[middle], deg=True))
    return Remark(
        "element-differs",
        f"the controlled element {what} is {given.name or 'another'}, but {by} "
        f"{found.name or 'another'}: at {omega[middle]:.2g} rad/s their gains are as {gain:.3g} to "
        f"1 and their phases {round(float(phase)):d} deg apart; margins with the wrong one mislead",
    )
