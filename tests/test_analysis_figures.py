"""Figures of an analysis, and symbols of quantities."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers import NOMINAL

from pilotid.analysis.figures import parts_figure
from pilotid.analysis.performance import performance_content, performance_rows
from pilotid.analysis.recordings import Part
from pilotid.analysis.rows import layouts
from pilotid.datasets import simulate
from pilotid.estimates.quantities import symbol
from pilotid.pilot.catalogue import MODELS
from pilotid.recordings.recording import Recording
from pilotid.support.numbers import recording_rng

pytestmark = pytest.mark.numerical
RECORDING: Recording = simulate(replace(NOMINAL, runs=3), recording_rng(1, "responses"))


def test_variances_have_a_bar_for_each_part() -> None:
    look = {"performance": performance_content(RECORDING)}
    part = Part((Path("a"),), (("subject", "1"), ("condition", "C1")))
    rows = performance_rows(part, look, per_run=False)
    found = layouts(list(rows))
    bars = parts_figure(found)
    assert bars is not None
    heights = [sum(patch.get_height() for patch in axes.patches) for axes in bars.axes[:3]]
    totals = [
        next(lay for lay in found if lay.parameter == f"var_{name}").cells["C1"]["1"].value
        for name in "eux"
    ]
    assert heights == pytest.approx(totals)
    assert parts_figure([lay for lay in found if "_remnant" not in lay.parameter]) is None


@pytest.mark.parametrize(
    ("key", "shown"),
    [
        ("Kvis", "$K_v$"),
        ("tlead2", "$T_{L,2}$"),
        ("Kvis*tlead", r"$K_v\,T_L$"),
        ("tlead2 - tlead1", "$T_{L,2} - T_{L,1}$"),
        ("fnm", r"$\omega_{nm}$"),
        ("var_e_target", r"$\sigma^2_{e,t}$"),
        ("rad/s", "rad/s"),
        ("C1:C2", "C1:C2"),
        ("own_gain", "own_gain"),
        ("", ""),
        ("12", "12"),
    ],
)
def test_symbols(key: str, shown: str) -> None:
    assert symbol(key) == shown


def test_every_parameter_of_the_catalogue_has_a_symbol() -> None:
    keys = {key for model in MODELS.values() if not model.changes for key in model.keys}
    assert {key for key in keys if not symbol(key).startswith("$")} == set()
