"""Figures as text where there is no display; else a page is opened in a browser."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pilotid.estimates.fitted import Fitted
from pilotid.show.responses import USUAL
from pilotid.study.comparison import Comparison
from pilotid.types import FloatArray

WIDTH, HEIGHT = 72, 14  # characters of a panel
MARKS = "*o+x#%@=&"  # of the first, second, ... curve
LEAST_LOSS = 0.5  # where bars begin


def opened(page: Path) -> bool:
    """Open a page in a browser; False where there is no display, or no browser."""
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not shown:
        return False
    import webbrowser

    try:
        return webbrowser.open(page.absolute().as_uri())
    except webbrowser.Error:
        return False


def fit_text(fit: Fitted) -> str:
    """The magnitude of each channel's response by each method, over frequency."""
    omega = np.geomspace(*USUAL, WIDTH)
    if fit.model.changes:
        return f"model {fit.model.name} varies in time: see the report"
    known = [e for e in fit.estimates if np.isfinite(e.values).all()]
    panels = []
    for number, channel in enumerate(fit.model.channels):
        curves = {e.method: np.abs(e.model.response(omega, e.values)[number]) for e in known}
        if curves:
            panels.append(panel_text(f"{channel.name} channel, |H|, over rad/s", omega, curves))
    return "\n\n".join(panels)


def panel_text(title: str, x: FloatArray, curves: Mapping[str, FloatArray]) -> str:
    """Curves over a common x, both axes logarithmic.

    Parameters
    ----------
    title
        Stands above, with the marks of the curves.
    x
        Where the curves are known, equally spaced on a logarithmic scale, shape (n,).
    curves
        Positive values by name, each of shape (n,).
    """
    every = np.log(np.maximum(np.concatenate([*curves.values()]), 1e-300))
    low, high = float(every.min()), float(every.max())
    high = max(high, low + 1e-6)
    rows = [[" "] * x.size for _ in range(HEIGHT)]
    for mark, values in zip(MARKS, curves.values(), strict=False):
        share = (np.log(np.maximum(values, 1e-300)) - low) / (high - low)
        for column, row in enumerate(np.round((1.0 - share) * (HEIGHT - 1)).astype(int)):
            if rows[row][column] == " ":  # the first method lies on top
                rows[row][column] = mark
    labels = {0: high, HEIGHT // 2: 0.5 * (low + high), HEIGHT - 1: low}
    lines = [
        f"{f'{np.exp(labels[n]):.3g}' if n in labels else '':>8} |{''.join(row).rstrip()}"
        for n, row in enumerate(rows)
    ]
    ends = f"{x[0]:.3g}", f"{np.sqrt(x[0] * x[-1]):.3g}", f"{x[-1]:.3g}"
    middle = x.size // 2 - len(ends[0])
    below = ends[0] + ends[1].center(middle * 2 - len(ends[2]) + len(ends[0])) + ends[2]
    legend = ", ".join(f"{mark} {name}" for mark, name in zip(MARKS, curves, strict=False))
    return "\n".join([f"{title}: {legend}", *lines, " " * 9 + "+" + "-" * x.size, " " * 10 + below])


def losses_text(study: Comparison, names: Sequence[str]) -> str:
    """Bars of the methods' losses in each scenario, on a logarithmic scale."""
    panels = []
    for name in names:
        own = [(c.method, c.scores[0].loss.value) for c in study.of(name) if c.scores]
        known = sorted((pair for pair in own if np.isfinite(pair[1])), key=lambda pair: pair[1])
        if known:
            most = np.log(max(known[-1][1] / LEAST_LOSS, 2.0))
            wide = max(len(method) for method, _ in known)
            lines = [f"{name}: loss, logarithmic; 1: exact and efficient"]
            for method, loss in known:
                length = round((WIDTH - wide) * max(0.0, np.log(loss / LEAST_LOSS)) / most)
                lines.append(f"{method:>{wide}} |{'#' * length} {loss:.3g}")
            panels.append("\n".join(lines))
    return "\n\n".join(panels)
