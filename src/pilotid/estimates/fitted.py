"""Estimates of one model from one recording, by several methods, and how they are printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import Method, identify
from pilotid.estimates.tables import quantity_table, side_by_side
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import remarks
from pilotid.recordings.recording import Recording
from pilotid.seeds import fit_rng
from pilotid.terminal import print_table

if TYPE_CHECKING:
    from rich.console import Console


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
    """

    recording: Recording
    model: PilotModel
    estimates: tuple[Estimate, ...]
    remarks: tuple[str, ...] = ()

    @property
    def heading(self) -> str:
        """One line that says what was fitted to what."""
        return f"{self.recording.description}; model {self.model.name}"

    def to_dict(self) -> dict[str, object]:
        """Plain objects, in the form that `pilotid fit --json` writes."""
        return {
            "recording": {**self.recording.to_dict(), "remarks": list(self.remarks)},
            "model": self.model.name,
            "estimates": [estimate.to_dict() for estimate in self.estimates],
        }

    @property
    def warnings(self) -> list[str]:
        """All remarks, each with what it is about."""
        found = [f"recording: {remark}" for remark in self.remarks]
        return found + [f"{e.method}: {remark}" for e in self.estimates for remark in e.remarks]

    def print(self, console: Console) -> None:
        """Print tables, a line for each method, and all remarks."""
        console.print(self.heading, style="bold", soft_wrap=True)
        shown = [(e.method, e.quantities) for e in self.estimates if np.isfinite(e.values).any()]
        sign = "±" if console.encoding == "utf-8" else "+-"
        for columns in side_by_side(shown, console.width):
            console.print()
            print_table(console, quantity_table(columns, sign))
        console.print()
        for estimate in self.estimates:
            style = None if estimate.outcome.usable else "red"
            console.print(estimate.verdict(), style=style, soft_wrap=True)
        for warning in self.warnings:
            console.print(warning, style="yellow", soft_wrap=True)


def fit_all(
    recording: Recording, model: PilotModel, methods: Mapping[str, Method], seed: int
) -> Fitted:
    """Run methods, by their labels, on a recording, each with its own random generator."""
    estimates = (
        replace(identify(method, recording, model, fit_rng(seed, label)), method=label)
        for label, method in methods.items()
    )
    return Fitted(recording, model, tuple(estimates), remarks(recording))
