"""Performance and control activity: variances of signals, and what they are made of.

At the lines of the target and the disturbance a signal holds the answer to them, and remnant.  The
answer is what a run has in common with the others, in phase with the forcing function; of fewer
than three runs it is what stands above the bins beside the line.  All the rest is remnant.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pilotid.experiment.results import LEFT_OUT, MEASURED
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import known_lines
from pilotid.support.numbers import LEVEL
from pilotid.support.remarks import Remark
from pilotid.support.types import FloatArray, IntArray

#: What variances are made of, and the signal that has each.
SOURCES = {"target": "ft", "disturbance": "fd"}
REMNANT = "remnant"
#: Runs of which each can be set against the mean of others.
ENOUGH = 3
#: Share of remnant in the control's variance.
SHARE = "remnant_share_u"


def performance(recording: Recording) -> dict[str, tuple[str, FloatArray]]:
    """Quantities of e, u and x: unit, and value in each run.

    ``var_e`` and ``rms_e``, and where forcing functions are multisines ``var_e_target``,
    ``var_e_disturbance`` (of those that there are) and ``var_e_remnant``, and `SHARE`.
    """
    lines = {} if lines_shared(recording) else known_lines(recording)
    every = np.concatenate([*lines.values()]) if lines else np.zeros(0, dtype=int)
    quantities: dict[str, tuple[str, FloatArray]] = {}
    for name in (name for name in ("e", "u", "x") if name in recording.signals):
        unit, signal = recording.units.get(name, ""), getattr(recording, name)
        window = recording.window(signal)
        total = rest = window.var(axis=1)
        square = f"({unit})^2" if "/" in unit else f"{unit}^2" * bool(unit)
        quantities[f"var_{name}"] = square, total
        quantities[f"rms_{name}"] = unit, np.sqrt(np.mean(window**2, axis=1))
        if not lines:
            continue
        for source, forcing in SOURCES.items():
            if forcing in lines:
                answer = _answer(recording, signal, forcing, lines[forcing], every)
                quantities[f"var_{name}_{source}"] = square, answer
                rest = rest - answer
        quantities[f"var_{name}_{REMNANT}"] = square, rest
        if name == "u":
            quantities[SHARE] = "", rest / total
    return quantities


def measured(recording: Recording) -> list[dict[str, Any]]:
    """What estimates have, of signals: the means over runs, and each of several runs alone."""
    from pandas import DataFrame
    from scipy.special import stdtrit

    known = performance(recording)
    units, values = zip(*known.values(), strict=True)
    runs, mean = recording.runs, np.mean(values, axis=1)
    error = np.std(values, axis=1, ddof=1) / math.sqrt(runs) if runs > 1 else np.nan * mean
    reach = stdtrit(max(runs - 1, 1), 1.0 - 0.5 * LEVEL) * error
    rows = DataFrame({"kind": MEASURED, "parameter": [*known], "unit": units})
    rows = rows.assign(determined=True, **{LEFT_OUT: ""})
    whole = rows.assign(value=mean, std_error=error, lower_95=mean - reach, upper_95=mean + reach)
    single = enumerate(zip(*values, strict=True), 1) if runs > 1 else ()
    shared: dict[str, Any]
    shared = {"model": "", "element": "", "method": MEASURED, "outcome": MEASURED, "usable": True}
    shared |= {"otherwise": "", "vaf": math.nan, "remarks": (), "loop_remarks": ()}
    return [
        {**shared, "run": run, "quantities": quantities.to_dict("records")}
        for run, quantities in [(None, whole), *((run, rows.assign(value=v)) for run, v in single)]
    ]


def lines_shared(recording: Recording) -> Remark | None:
    """What to say where nothing tells the answers to target and disturbance apart."""
    lines = known_lines(recording)
    if len(lines) < 2 or not np.intersect1d(lines["ft"], lines["fd"]).size:
        return None
    return Remark(
        "shared-lines",
        "ft and fd have lines in common, so that variances of e, u and x are not split into the "
        "answers to each and remnant",
    )


def _answer(
    recording: Recording, signal: FloatArray, forcing: str, lines: IntArray, every: IntArray
) -> FloatArray:
    """Variance of the answer to a forcing function at its lines in each run, shape (runs,)."""
    spectrum = np.fft.rfft(recording.window(signal)) / recording.samples
    values, runs = spectrum[:, lines], recording.runs
    if runs < ENOUGH:
        free = np.setdiff1d(np.arange(1, spectrum.shape[1]), every)
        after = np.clip(np.searchsorted(free, lines), 1, free.size - 1)
        beside = np.mean(np.abs(spectrum[:, [free[after - 1], free[after]]]) ** 2, axis=1)
        return np.asarray(2.0 * np.sum(np.abs(values) ** 2 - beside, axis=1))
    source = recording.input("ft") if forcing == "ft" else recording.fd
    if source is not None:
        values = values * np.exp(-1j * np.angle(np.fft.rfft(recording.window(source))[:, lines]))
    others = (values.sum(axis=0) - values) / (runs - 1)
    common = 2.0 * np.sum((values * others.conj()).real, axis=1)
    # A run counts in its own product and in those of the others: the scatter is twice as large.
    return np.asarray(2.0 * common - common.mean())
