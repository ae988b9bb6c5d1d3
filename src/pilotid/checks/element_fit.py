"""The controlled element that a recording shows: identified from u, fd and x.

x = Hc (u + fd) holds in the recording almost without noise, so that a few forms of low order are
fitted to windowed spectra (`pilotid.checks.element_forms`) of all runs at once.  The
simplest that describes the recording is taken: one that leaves less of x than anyone would
notice, or else the one of the smallest Bayesian information criterion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pilotid.checks.detectors import findings
from pilotid.checks.element_forms import HIGHEST, OMEGA, FormFit, fits_of, simplest, spectra_of
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

    It has a name that `element_named` reads.
    """
    if not np.ptp(recording.window(recording.x), axis=1).any():
        is_there = "x" in recording.signals
        return ElementChoice(why=f"x {'does not move' if is_there else 'was not recorded'}")
    every = fits_of(recording)
    fits = [fit for fit in every if _is_steerable(fit.element)]
    if not fits:
        left = min((fit.left for fit in every), default=0.0)
        return ElementChoice(why="no form of element suits control and output", left=left)
    chosen = simplest(fits)
    # Drift of x makes slow unstable poles, which explain no more where loops cross over.
    near = [f for f in fits if f.form.size <= chosen.form.size and f.left <= 1.225 * chosen.left]
    steady = [f for f in near if _is_steerable(f.element, ELEMENT.slowest_pole)]
    chosen = simplest(steady or [chosen])
    element = chosen.rounded()
    why = _against(element, chosen, recording.fd is not None)
    return ElementChoice(element, "identified", why, left=chosen.left)


def _is_steerable(element: ControlledElement, slowest_pole: float = 0.0) -> bool:
    """Whether people can keep a loop with the element stable, with no slower unstable pole [rad/s].

    With a zero z and a pole p in the right half-plane the sensitivity is at least
    (z + p)/|z - p| somewhere, and its complement e^(p delay) with a delay (Skogestad &
    Postlethwaite, *Multivariable Feedback Control*, ch. 5); where noise is fitted zero and pole are
    nearly one.
    """
    every = (np.roots(polynomial) for polynomial in (element.numerator, element.denominator))
    zeros, pole = (roots.real[roots.real > 0.0] for roots in every)
    zero = min([*zeros, 1e9])  # forms have one; without it the delay alone counts
    sensitivity = pole * element.delay + np.log((zero + pole) / np.abs(zero - pole))
    is_held = (pole >= slowest_pole) & (pole <= ELEMENT.fastest_pole)
    is_held &= sensitivity <= np.log(ELEMENT.sensitivity)
    return bool(zero >= ELEMENT.slowest_zero and is_held.all())


def _against(element: ControlledElement, fit: FormFit, is_forced: bool) -> str:
    """What speaks against an identified element, in a sentence; empty if nothing does."""
    missing = "perhaps another" if is_forced else "most often a"
    early, error = -fit.element.delay, float(fit.error_at(OMEGA).max())
    last = np.trim_zeros(np.array(element.denominator))[-1]
    if fit.left > ELEMENT.unexplained:
        return (
            "control and output follow no one controlled element of low order: the best, "
            f"{element.name}, leaves about {100.0 * fit.left:.0f} % of the amplitude of x; "
            f"{missing} disturbance was not recorded, or the element changes within a run, a "
            "signal is late, or a name, a unit or a sign is wrong"
        )
    if early > ELEMENT.late:
        return (
            f"x seems to answer {1e3 * early:.0f} ms before u moves, as {element.name} would: "
            "u is late, or has noise in it that did not reach the element"
        )
    if error > ELEMENT.known:
        return (
            f"control and output tell the controlled element, {element.name}, to within "
            f"{100.0 * error:.0f} % only where loops cross over"
        )
    is_negative = max(element.numerator[0], element.numerator[-1] * last) < 0.0
    end = "whose gain is negative: u or x seems to have the wrong sign"
    return f"control and output follow {element.name}, {end}" if is_negative else ""


@remembered
def confirmed_element(recording: Recording) -> ControlledElement | None:
    """The element that the file names, where its signals follow it closely; else None."""
    named = parsed_element(recording.controlled_element)
    if named is None or len(named.denominator) - 1 > HIGHEST:
        return None
    spectra = spectra_of(recording)
    with np.errstate(all="ignore"):  # signals that do not move, which tell nothing
        unexplained = spectra.unexplained(spectra.rows(named, slice(0))[-1])
    return named if unexplained.max() <= (0.5 * ELEMENT.different) ** 2 else None


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
        return ElementChoice(confirmed, "recording")  # to ask signals for a form takes long
    named, identified = parsed_element(recording.controlled_element), identified_element(recording)
    fault = next((f for f in findings(recording) if f.grade != "note" and not f.is_turned), None)
    shifted = fault and fault.code == "late-signal" and abs(fault.size) > ELEMENT.late
    shown = None if identified.why or shifted else identified.element
    stated = as_element(given) if given else named
    if stated is None:
        why = fault.sentence if fault else f"{identified.why}; name it, for example --element 4/s^2"
        choice = identified if shown else ElementChoice(why=f"no loops: {why}")
        text = recording.controlled_element.strip()
        words = (
            f"the file calls the controlled element {text!r:.50}, which is none; write 4/s^2 or so"
        )
        return replace(choice, remarks=(Remark("element-differs", words, "note"),) * bool(text))
    choice, other = ElementChoice(stated, "given" if given else "recording"), shown or named
    if other is None or not differ(stated, other):
        return choice
    by = "control and output of the recording follow" if shown else "the file names"
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
    doubted = choice.element and choice.remarks
    return identified_element(recording).element if doubted else choice.element
