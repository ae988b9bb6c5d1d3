"""The loops of an estimate with a controlled element: what they are and how they are told."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pilotid.estimates.quantities import Quantity
from pilotid.pilot.element import ControlledElement
from pilotid.recordings.recording import Recording
from pilotid.remarks import codes_of


@dataclass(frozen=True, eq=False)
class LoopElement:
    """The controlled element that loops are drawn with.

    Attributes
    ----------
    element
        None if none is known.
    origin
        ``given``, named by the ``recording``, or ``identified`` from its signals.
    why
        Why none is known, in a sentence.
    remarks
        Where what is said of it and what signals show disagree, a sentence each.
    """

    element: ControlledElement | None = None
    origin: str = ""
    why: str = ""
    remarks: tuple[str, ...] = ()

    def named_in(self, recording: Recording) -> Recording:
        """The recording, naming the element that was given, for methods that need the loop."""
        if self.origin != "given" or self.element is None:
            return recording
        return replace(recording, controlled_element=self.element.name)

    @property
    def words(self) -> str:
        """The element and where it comes from."""
        if self.element is None:
            return self.why
        origins = {"recording": "named by the recording", "identified": "identified from u, fd, x"}
        name = self.element.name or "user-defined"
        return f"loops with the controlled element {name}, {origins.get(self.origin, 'as given')}"


@dataclass(frozen=True, eq=False)
class Loop:
    """One open loop of an estimate.

    Attributes
    ----------
    name
        ``target`` or ``disturbance``.
    crossover, phase_margin
        NaN where there is none.
    others
        Further frequencies where the magnitude falls through one [rad/s].
    remark
        Why there is no crossover, or what else should be known; empty if nothing should.
    """

    name: str
    crossover: Quantity
    phase_margin: Quantity
    others: tuple[float, ...] = ()
    remark: str = ""

    @property
    def notes(self) -> list[str]:
        """What should be known of it, a sentence each."""
        found = [f"{self.name} loop: {self.remark}"] if self.remark else []
        if self.others:
            where = ", ".join(f"{w:.3g}" for w in self.others)
            found.append(f"the {self.name} loop falls through one again at {where} rad/s")
        return found

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        return {
            "crossover": self.crossover.to_dict(),
            "phase_margin": self.phase_margin.to_dict(),
            "others": list(self.others),
            "remark": self.remark,
        }


@dataclass(frozen=True, eq=False)
class Loops:
    """Both open loops of an estimate with a controlled element.

    Attributes
    ----------
    element
        The controlled element.
    target, disturbance
        The loops, see `pilotid.pilot.loops`.
    remarks
        What speaks against them, a sentence each.
    """

    element: ControlledElement
    target: Loop
    disturbance: Loop
    remarks: tuple[str, ...] = ()

    @property
    def quantities(self) -> list[Quantity]:
        """Crossover frequency and phase margin of the target, then of the disturbance loop."""
        return [
            q for lp in (self.target, self.disturbance) for q in (lp.crossover, lp.phase_margin)
        ]

    @property
    def notes(self) -> list[str]:
        """What should be known of the margins, a sentence each."""
        return [*self.target.notes, *self.disturbance.notes]

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them; NaN where there is none."""
        return {
            "element": self.element.name,
            "target": self.target.to_dict(),
            "disturbance": self.disturbance.to_dict(),
            "remarks": list(self.remarks),
            "codes": codes_of(self.remarks),
        }


def no_loop(name: str, why: str, others: tuple[float, ...] = ()) -> Loop:
    """A loop without a crossover, and why."""
    nan = float("nan")
    crossover, phase_margin = (Quantity(k, u, nan, nan, nan, nan) for k, u in loop_keys(name))
    return Loop(name, crossover, phase_margin, others, why)


def loop_keys(name: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Keys and units of a loop's two quantities."""
    return (f"{name}_crossover", "rad/s"), (f"{name}_phase_margin", "deg")
