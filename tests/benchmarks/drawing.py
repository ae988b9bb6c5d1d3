"""The scaling of fits, drawn from what was timed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from timings import scaling

from pilotid.show.style import WIDTH, colour_of, journal_style, log_ticks, marker_of

LABELS = {"duration": "window [s]", "runs": "runs", "dt": "sampling interval [s]"}


def draw(times: Mapping[str, Any], file: Path) -> None:
    """The scaling of each method over length, runs and rate, with N log N beside."""
    found = scaling(times)
    axes_of = [axis for axis in LABELS if axis in found]
    if not axes_of:
        return
    with journal_style():
        figure = Figure(figsize=(WIDTH, 2.7), layout="constrained")
        panels = figure.subplots(1, len(axes_of), sharey=True, squeeze=False)[0]
        for axis, panel in zip(axes_of, panels, strict=True):
            for method, rows in found[axis].items():
                values, times_ms, _ = zip(*rows, strict=True)
                panel.plot(values, times_ms, color=colour_of(method), marker=marker_of(method),
                           markersize=3.5, linewidth=0.9, label=method)  # fmt: skip
            longest = max(found[axis].values(), key=len)
            work = [(v, n * math.log(n)) for v, _, n in longest]
            for start in (1e-5, 1e-4, 1e-3):
                panel.plot([v for v, _ in work], [start * w for _, w in work], color="#d5d9e0",
                           linewidth=0.7, zorder=0, scalex=False, scaley=False)  # fmt: skip
            panel.set_xscale("log")
            log_ticks(panel, "x")
            panel.set_xlabel(LABELS[axis])
        every = [ms for by in found.values() for rows in by.values() for _, ms, _ in rows]
        panels[0].set_yscale("log")
        panels[0].set_ylim(0.6 * min(every), 1.6 * max(every))
        log_ticks(panels[0], "y")
        panels[0].set_ylabel("time of a fit, shortest of several [ms]")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right upper")
        figure.savefig(file, metadata={"Date": None})
