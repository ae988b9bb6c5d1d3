"""The controlled element that a recording shows: identified from u, fd and x.

x = Hc (u + fd) holds in the recording almost without noise, so that a few forms of low order are
fitted to windowed spectra (`pilotid.checks.element_forms`) of all runs at once.  Of those that
leave as little of x as the one of the smallest Bayesian information criterion, the simplest is
taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pilotid.checks.element_forms import HIGHEST, OMEGA, fits_of, power, simplest, spectra_of
from pilotid.model.element import ControlledElement, as_element, parsed_element
from pilotid.recording.recording import Recording, remembered
from pilotid.support.limits import ELEMENT
from pilotid.support.remarks import Remark

#: A controlled element as users give it: itself, its text, or nothing.
GivenElement = ControlledElement | str | None
#: Origins of an element, and their words.
ORIGINS = {"given": "given", "recording": "the file says", "identified": "from the signals"}


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
        Why none is known, in a sentence; empty if one is.
    remarks
        Where what is said of it and what signals show disagree, a sentence each.
    left
        Share of the amplitude of x that the best one leaves where loops cross over.
    """

    element: ControlledElement | None = None
    origin: str = ""
    why: str = ""
    remarks: tuple[Remark, ...] = ()
    left: float = 0.0

    def named_in(self, recording: Recording) -> Recording:
        """The recording, naming the element that was given, for methods that need the loop."""
        if self.element and self.origin == "given":
            return replace(recording, controlled_element=self.element.name)
        return recording

    @property
    def words(self) -> str:
        """The element and where it comes from; why not, if it is not known."""
        if self.element is None:
            return self.why
        return f"{self.element.name or 'user-defined'} ({ORIGINS[self.origin]})"


@remembered
def identified_element(recording: Recording) -> ElementChoice:
    """The controlled element that u, fd and x show, with numbers rounded to their errors.

    It has a name that `element_named` reads.  None where it explains too little of x, or is too
    uncertain, to draw loops with.
    """
    fits = [fit for fit in fits_of(recording) if _is_steerable(fit.element)]
    if not fits:
        return ElementChoice(why="x was not recorded, does not move, or answers to no element")
    # Drift of x makes slow unstable poles, which explain no more where loops cross over: of those
    # without, the simplest that leaves about as much (1.5 and 1.7 times tell the same but for one
    # of 1,270 recordings, which had a filter on u).
    best = simplest(fits)
    near = [f for f in fits if f.left <= 1.7 * best.left]
    steady = [f for f in near if _is_steerable(f.element, ELEMENT.slowest_pole)]
    chosen = min(steady or [best], key=lambda f: (f.form.size, f.criterion))
    element, error = chosen.rounded(), float(chosen.error_at(OMEGA).max())
    if max(chosen.left, error) <= ELEMENT.unexplained:
        return ElementChoice(element, "identified", left=chosen.left)
    missing = "most often a" if recording.fd is None else "perhaps another"
    why = (
        f"control and output tell no one controlled element of low order: the best, {element.name},"
        f" leaves about {100.0 * chosen.left:.0f} % of the amplitude of x and is uncertain by "
        f"{100.0 * error:.0f} %; {missing} disturbance was not recorded, or the element changes "
        "within a run, a signal is late, or a name, a unit or a sign is wrong"
    )
    return ElementChoice(why=why, left=chosen.left)


def _is_steerable(element: ControlledElement, slowest_pole: float = 0.0) -> bool:
    """Whether people can keep a loop with the element stable, with no slower unstable pole [rad/s].

    With a zero z and a pole p in the right half-plane the sensitivity is at least
    (z + p)/|z - p| somewhere, and its complement e^(p delay) with a delay (Skogestad &
    Postlethwaite, *Multivariable Feedback Control*, ch. 5); where noise is fitted zero and pole are
    nearly one.  Nor does an element answer before u moves, nor has it a negative gain, which is a
    wrong sign of u or x.
    """
    every = (np.roots(polynomial) for polynomial in (element.numerator, element.denominator))
    zeros, pole = (roots.real[roots.real > 0.0] for roots in every)
    zero = min([*zeros, 1e9])  # forms have one at most; without it the delay alone counts
    delay = element.delay + ELEMENT.pilot_delay
    sensitivity = pole * delay + np.log((zero + pole) / np.abs(zero - pole))
    is_held = (pole >= slowest_pole) & (sensitivity <= np.log(ELEMENT.sensitivity))
    return bool(element.numerator[-1] > 0.0 and element.delay >= -ELEMENT.late and is_held.all())


@remembered
def confirmed_element(recording: Recording) -> ControlledElement | None:
    """The element that the file names, where its signals follow it closely; else None."""
    named = parsed_element(recording.controlled_element)
    if named is None or len(named.denominator) - 1 > HIGHEST:
        return None
    spectra = spectra_of(recording)
    with np.errstate(all="ignore"):  # signals that do not move, which tell nothing
        left = power(spectra.rows(named, slice(0))[-1], spectra.fine) / spectra.size
    return named if left.max() <= (0.5 * ELEMENT.different) ** 2 else None


def unexplained(recording: Recording) -> Remark | None:
    """A doubt where x is the answer to u + fd by no element of low order."""
    sound = recording.fd is None or confirmed_element(recording)
    if sound or (found := identified_element(recording)).left <= ELEMENT.unexplained:
        return None
    return Remark("output-unrelated", found.why, "doubt")


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
        return ElementChoice(confirmed, "recording")  # to ask signals for a form takes long
    named, identified = parsed_element(recording.controlled_element), identified_element(recording)
    stated = as_element(given) if given else named
    if stated is None:
        why = identified.why and f"no loops: {identified.why}; name it, for example --element 4/s^2"
        text = recording.controlled_element.strip()
        words = (
            f"the file calls the controlled element {text!r:.50}, which is none; write 4/s^2 or so"
        )
        remark = Remark("element-differs", words, "note")
        return replace(identified, why=why, remarks=(remark,) * bool(text))
    choice = ElementChoice(stated, "given" if given else "recording")
    other = identified.element or named
    if other is None or not differ(stated, other):
        return choice
    by = "control and output of the recording follow" if identified.element else "the file names"
    words = (
        f"the controlled element {'given' if given else 'that the file names'} is "
        f"{stated.name or 'another'}, but {by} {other.name}; margins with the wrong one mislead"
    )
    return replace(choice, remarks=(Remark("element-differs", words),))


def differ(one: ControlledElement, other: ControlledElement) -> bool:
    """Whether two controlled elements are different ones where loops cross over."""
    with np.errstate(all="ignore"):  # a pole or a zero may lie at a frequency
        ratio = one.response(OMEGA) / other.response(OMEGA)
        return bool(np.sqrt(np.mean(np.abs(ratio - 1.0) ** 2)) > ELEMENT.different)


@remembered
def closing_element(recording: Recording) -> ControlledElement | None:
    """The controlled element that closes the loop of a recording.

    The one that the recording names, unless its signals show another one; None if none is known.
    """
    choice = chosen_element(recording)
    return (identified_element(recording) if choice.remarks else choice).element
