"""Methods that take the remnant for white say so where it is not."""

from __future__ import annotations

import pytest
from helpers import NOMINAL, fit_of

from pilotid.datasets import SCENARIOS
from pilotid.methods import method_named
from pilotid.support.remarks import codes_of

pytestmark = pytest.mark.numerical


@pytest.mark.parametrize("name", ["mle-white", "mle-genetic", "mmle3", "bayes-white"])
def test_a_coloured_residual_is_a_doubt(name: str) -> None:
    method = method_named(name)
    assert "residual-not-white" in codes_of(fit_of(method, NOMINAL).remarks)
    for replication in range(3):
        fit = fit_of(method, SCENARIOS["white-remnant"], replication)
        assert "residual-not-white" not in codes_of(fit.remarks)
