"""Figures as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pilotid.cli.main import main
from pilotid.show.text_figures import HEIGHT, opened, panel_text


def test_a_straight_line_on_logarithmic_axes_is_a_diagonal() -> None:
    x = np.geomspace(0.1, 10.0, HEIGHT)
    lines = panel_text("gain", x, {"rising": x**2, "falling": 1.0 / x**2}).splitlines()
    assert lines[0] == "gain: * rising, o falling"
    rows = [line.partition("|")[2].ljust(HEIGHT) for line in lines[1 : HEIGHT + 1]]
    assert [row.index("*") for row in rows] == list(range(HEIGHT))[::-1]
    assert [row.index("o") for row in rows] == list(range(HEIGHT))
    assert lines[1].split("|")[0].strip() == "100"
    assert lines[HEIGHT].split("|")[0].strip() == "0.01"


def test_without_a_display_nothing_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not opened(Path("report.html"))


def test_fit_draws_in_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("pilotid.show.text_figures.opened", lambda page: False)
    run, page = str(tmp_path / "run.csv"), tmp_path / "page.html"
    for words in (
        ["simulate", "single", "--out", run],
        ["fit", run, "--model", "single", "--method", "fourier", "--plot", "--report", str(page)],
    ):
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert not ended.value.code
    printed = capsys.readouterr().out
    assert "visual channel, |H|, over rad/s: * fourier" in printed
    assert page.exists()
