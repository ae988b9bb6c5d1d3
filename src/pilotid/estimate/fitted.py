"""Estimates of one model from one recording, by several methods."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from pilotid.checks.checks import remarks
from pilotid.estimate.estimate import Estimate
from pilotid.estimate.loops import Loops
from pilotid.estimate.method import Method, identify
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import NotMultisineError, forcing_sines
from pilotid.support.numbers import fit_rng
from pilotid.support.remarks import Remark, gravest_first, remark_of, remarks_json, without

if TYPE_CHECKING:
    from pilotid.element_fit import ElementChoice


@dataclass(frozen=True, eq=False)
class Fitted:
    """All estimates of one model from one recording.

    Attributes
    ----------
    recording, model
        What was fitted to what.
    estimates
        One for each method.
    remarks
        What is wrong with the recording, a sentence each.
    loop_element
        The controlled element that loops are drawn with; None where nobody asked for loops.
    choice
        Why the model was chosen, in sentences; empty where it was named.
    compared
        Plain objects on the models that were compared.
    ignored
        Codes of remarks that the user does not want to see.
    """

    recording: Recording
    model: PilotModel
    estimates: tuple[Estimate, ...]
    remarks: tuple[str, ...] = ()
    loop_element: ElementChoice | None = None
    choice: str = ""
    compared: tuple[Mapping[str, object], ...] = ()
    ignored: frozenset[str] = frozenset()

    def without(self, codes: frozenset[str]) -> Fitted:
        """The same without remarks of these codes."""
        estimates = tuple(replace(e, remarks=without(e.remarks, codes)) for e in self.estimates)
        remarks = without(self.remarks, codes)
        return replace(self, estimates=estimates, remarks=remarks, ignored=codes)

    @cached_property
    def loops(self) -> tuple[Loops, ...]:
        """The loops of each estimate, in their order; empty where no element is known."""
        if self.loop_element is None or self.loop_element.element is None:
            return ()
        element = self.loop_element.element
        every = (e.loops(element).excited_by(self.recording) for e in self.estimates)
        return tuple(replace(own, remarks=without(own.remarks, self.ignored)) for own in every)

    @property
    def heading(self) -> str:
        """One line that says what was fitted to what."""
        return f"{self.recording.description}; model {self.model.name}"

    def to_dict(self) -> dict[str, object]:
        """Plain objects, in the form that `pilotid fit --json` writes."""
        return {
            "recording": {
                **self.recording.to_dict(),
                "forcing": self._forcing(),
                **remarks_json(self.remarks),
            },
            **({"ignored": sorted(self.ignored)} if self.ignored else {}),
            "model": self.model.name,
            **({"choice": self.choice, "models": list(self.compared)} if self.choice else {}),
            "estimates": [
                {**estimate.to_dict(), **loops}
                for estimate, loops in zip(self.estimates, self._loop_dicts(), strict=True)
            ],
        }

    def _forcing(self) -> dict[str, object]:
        """The forcing functions as sums of sines; none where they are something else."""
        try:
            return {**forcing_sines(self.recording)}
        except NotMultisineError:
            return {}

    def _loop_dicts(self) -> list[dict[str, object]]:
        """What the loops add to each estimate's object."""
        given = self.loop_element
        if given is None:
            return [{} for _ in self.estimates]
        if given.element is None:
            why = Remark("element-unknown", given.why)
            return [{"loops": {"element": None, **remarks_json([why])}} for _ in self.estimates]
        return [{"loops": {**loops.to_dict(), "origin": given.origin}} for loops in self.loops]

    @property
    def graded(self) -> dict[Remark, str]:
        """All remarks, each once with what it is about, those that say what is wrong first."""
        found = [("recording", remark_of(remark)) for remark in self.remarks]
        found += [(e.method, remark_of(remark)) for e in self.estimates for remark in e.remarks]
        pairs = zip(self.estimates, self.loops, strict=False)
        found += [(e.method, remark_of(remark)) for e, loops in pairs for remark in loops.remarks]
        about: dict[Remark, str] = {}
        for remark in gravest_first(remark for _, remark in found):
            about[remark] = ", ".join(dict.fromkeys(who for who, own in found if own == remark))
        return about

    @property
    def warnings(self) -> list[str]:
        """All remarks in words, those that say what is wrong first."""
        return [remark.line(about) for remark, about in self.graded.items()]


def fit_all(
    recording: Recording,
    model: PilotModel,
    methods: Mapping[str, Method],
    seed: int,
    loop_element: ElementChoice | None = None,
) -> Fitted:
    """Run methods, by their labels, on a recording, each with its own random generator.

    Parameters
    ----------
    recording, model, methods, seed
        What is fitted to what.
    loop_element
        The controlled element that loops are drawn with, see
        `pilotid.element_fit.chosen_element`; None for no loops.
    """
    closed = recording if loop_element is None else loop_element.named_in(recording)
    with redirect_stdout(sys.stderr):  # what methods of others print is no part of an answer
        estimates = tuple(
            replace(identify(method, closed, model, fit_rng(seed, label)), method=label)
            for label, method in methods.items()
        )
    found = (*remarks(closed), *(loop_element.remarks if loop_element else ()))
    return Fitted(recording, model, estimates, found, loop_element)
