"""The files of a design: design.json and forcing.csv."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.datasets.named import scenario_json
from pilotid.designing.design import Design
from pilotid.designing.lines import sines_of
from pilotid.disk import strict_json, table_bytes, write_file
from pilotid.types import FloatArray

FADE = 2.0  # s


def design_json(made: Design, about: dict[str, Any], place: str = "") -> dict[str, Any]:
    """A design as plain objects: what it is, what it gives, and all to reproduce it.

    A model that is not the catalogue's is found at `place`.
    """
    lines = made.lines
    signals = {}
    for name, at in lines.signals:
        sines = sines_of(made.scenario, name)
        assert sines is not None
        signals[name] = {
            "lines": list(sines.lines),
            "omega": lines.omega[at].tolist(),
            "amplitudes": list(sines.amplitudes),
            "phases": list(sines.phases),
            "crest_factor": made.crest[name][0],
        }
    return {
        **about,
        "objective": {
            "minimise": None if made.wanted else made.minimise,
            "wanted": dict(made.wanted) or None,
            "limits": asdict(made.limits),
            "pilots": len(made.loops),
            "over": made.over,
            "remnant": made.remnant,
            "lines_shared": made.lines.shared,
            "seed": made.seed,
        },
        "reference": made.reference.name,
        "gap": made.gap,
        "binding": [{"limit": name, "price": price} for name, price in made.optimum.prices],
        "window": made.scenario.duration,
        "shortest_window": made.unrounded if made.wanted else None,
        "errors": {
            key: {
                "relative": made.errors[key],
                "reference": made.reference_errors[key],
                "remnant_held": made.errors_if_held[key],
                "remnant_scaled_to_control": made.errors_if_scaled[key],
            }
            for key in made.errors
        },
        "costs": made.costs,
        "rms": made.rms,
        "pilots": list(made.gains),
        "signals": signals,
        "scenario": scenario_json(made.scenario, place),
    }


def forcing_table(made: Design, rate: float | None = None, fade: float = FADE) -> FloatArray:
    """Time and the forcing functions, for the apparatus, shape (times, 3 or 4).

    The measurement window begins at t = 0.  Before it the signals run on from the run-in's
    beginning, where they are faded in; a run-in shorter than the fade is as long as that.  After
    the window they are faded out.  Where both signals have
    lines in common, the disturbance of the second, fourth, ... run is a column more.

    Parameters
    ----------
    made
        The design.
    rate
        Samples per second; None for the scenario's.
    fade
        Length of each fade [s].
    """
    scenario = made.scenario
    step = scenario.dt if rate is None else 1.0 / rate
    first = -round(max(scenario.run_in, fade) / step)
    last = round((scenario.duration + fade) / step)
    time = np.asarray(np.arange(first, last + 1) * step, dtype=float)
    begun, left = time - time[0], time[-1] - time
    gain = _ramp(begun, fade) * _ramp(left, fade)
    both = [
        np.zeros(time.size) if forcing is None else gain * forcing.at(time)
        for forcing in (scenario.target, scenario.disturbance)
    ]
    turned = [-both[1]] if scenario.alternating else []
    return np.column_stack([time, *both, *turned])


def _ramp(time: FloatArray, length: float) -> FloatArray:
    """From 0 to 1 within a length, without a corner."""
    if length <= 0.0:
        return np.ones(time.size)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(time / length, 0.0, 1.0)))


def write_files(
    folder: Path,
    made: Design,
    about: dict[str, Any],
    rate: float | None,
    fade: float,
    place: str = "",
) -> None:
    """Write design.json and forcing.csv."""
    write_file(folder / "design.json", strict_json(design_json(made, about, place)).encode())
    names = ("t", "ft", "fd_1", "fd_2") if made.scenario.alternating else ("t", "ft", "fd")
    rows = [[f"{value + 0.0:.9g}" for value in row] for row in forcing_table(made, rate, fade)]
    write_file(folder / "forcing.csv", table_bytes(names, rows))
