"""Fixtures that several test files share; plain functions are in `helpers.py` beside this."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers import Answer, Run

from pilotid.cli.main import main


@pytest.fixture(scope="session", autouse=True)
def everyday(pytestconfig: pytest.Config) -> Iterator[None]:
    """Everyday tests write empty files of figures as PDF, most of whose time goes into fonts.

    Tests that look at them take `pilotid.plots.page.pdf` itself, or are long.  Tables
    are as wide as where nobody says how wide a terminal is; workers of pytest-xdist are told.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("COLUMNS", raising=False)
        if pytestconfig.getoption("markexpr") == "not long":
            patch.setattr("pilotid.plots.page.pdf", lambda drawing: b"%PDF-")
        yield


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in this process."""

    def command(*arguments: object) -> Answer:
        with pytest.raises(SystemExit) as end:
            main([str(a) for a in arguments])
        captured = capfd.readouterr()
        return Answer(int(end.value.code or 0), captured.out, captured.err)

    return command


@pytest.fixture
def measured() -> Path:
    """The folder of recordings of human pilots."""
    folder = os.environ.get("PILOTID_MEASURED")
    if not folder:
        pytest.skip("PILOTID_MEASURED names no folder of recordings")
    return Path(folder)
