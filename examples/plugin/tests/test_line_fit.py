"""What the method promises, and a fit whose answer is known."""

import numpy as np
import pytest
from line_fit import LineFit

import pilotid
from pilotid.testing import check_method


def test_it_keeps_the_contract() -> None:
    check_method(LineFit())


def test_it_finds_the_pilot_of_a_recording() -> None:
    recording = pilotid.simulate("single", 1)
    estimate = pilotid.identify(LineFit(), recording, "single")
    assert estimate.outcome.usable
    assert estimate["tdvis"].value == pytest.approx(0.39, abs=0.05)  # what was simulated
    assert np.isfinite(estimate.std_error).all()
