"""Estimates as JSON and as tables on the terminal."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pilotid.estimate import Estimate
from pilotid.fits import Fit, Quantity, derived, parameters
from pilotid.model import PilotModel
from pilotid.noise import RemnantEstimate
from pilotid.recording import SIGNALS, Recording
from pilotid.response import FrequencyResponse

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table

T = TypeVar("T")

PLAIN_WIDTH = 120  # columns of output that does not go to a terminal


# ------------------------------------------------------------------------------------- JSON


def fit_json(fit: Fit) -> dict[str, object]:
    """A fit as plain objects, in the form that `pilotid fit --json` writes."""
    return {
        "recording": _recording_json(fit.recording),
        "model": fit.model.name,
        "estimates": [estimate_json(estimate) for estimate in fit.estimates],
    }


def estimate_json(estimate: Estimate) -> dict[str, object]:
    """An estimate as plain objects."""
    starts = estimate.starts
    result: dict[str, object] = {
        "method": estimate.method,
        "outcome": estimate.outcome.slug,
        "message": estimate.sentence,
        "parameters": _quantities_json(parameters(estimate)),
        "derived": _quantities_json(derived(estimate)),
        "correlation": estimate.correlation.tolist(),
        "vaf": estimate.vaf,
        "iterations": estimate.iterations,
        "starts": starts and {"total": len(starts.cost), "agreeing": starts.agreeing},
        "seconds": estimate.seconds,
    }
    remnant = estimate.remnant
    if remnant is not None:
        result["remnant"] = {
            "model": remnant.model,
            "parameters": remnant.parameters,
            "power_ratio": remnant.power_ratio,
            "omega": remnant.omega.tolist(),
            "density": remnant.density.tolist(),
        }
    if estimate.frequency_response is not None:
        result["frequency_response"] = _response_json(estimate.model, estimate.frequency_response)
    return result


def _response_json(model: PilotModel, response: FrequencyResponse) -> dict[str, object]:
    result: dict[str, object] = {"omega": response.omega.tolist()}
    if response.note:
        result["note"] = response.note
    for c, channel in enumerate(model.channels):
        entry = {
            "real": np.real(response.value[c]).tolist(),
            "imag": np.imag(response.value[c]).tolist(),
            "std": response.std[c].tolist(),
        }
        if response.systematic is not None:
            entry["systematic"] = response.systematic[c].tolist()
        result[channel.name] = entry
    return result


def strict_json(value: object) -> str:
    """JSON text; what is not finite becomes null, since JSON has no word for it."""
    return json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _recording_json(recording: Recording) -> dict[str, object]:
    return {
        "source": recording.source,
        "runs": recording.runs,
        "samples": recording.samples,
        "dt": recording.dt,
        "duration": recording.duration,
        "run_in": recording.run_in * recording.dt,
        "signals": [name for name in SIGNALS if getattr(recording, name) is not None],
        "units": dict(recording.units),
        "lines": {name: list(lines) for name, lines in recording.lines.items()},
        "controlled_element": recording.controlled_element,
    }


def _quantities_json(quantities: Iterable[Quantity]) -> dict[str, object]:
    return {
        q.key: {
            "value": q.value,
            "std_error": q.std_error,
            "interval_95": [q.lower, q.upper],
            "unit": q.unit,
        }
        for q in quantities
    }


# ------------------------------------------------------------------------------------ words


def heading(fit: Fit) -> str:
    """One line that says what was fitted to what."""
    r = fit.recording
    runs = "1 run" if r.runs == 1 else f"{r.runs} runs"
    run_in = f" after {r.run_in * r.dt:.4g} s of run-in" if r.run_in else ""
    return (
        f"{r.source}: {runs} of {r.duration:.4g} s at {1.0 / r.dt:.4g} Hz{run_in}; "
        f"model {fit.model.name}"
    )


def verdict(estimate: Estimate, *, timed: bool = True) -> str:
    """One line that says how a fit ended, and how well the model describes the control.

    Parameters
    ----------
    estimate
        The estimate.
    timed
        Whether to tell the time it took, which differs from run to run.
    """
    parts = [estimate.sentence]
    if math.isfinite(estimate.vaf):
        parts.append(f"VAF {estimate.vaf:.1f} %")
    if estimate.starts:
        parts.append(f"{estimate.starts.agreeing} of {len(estimate.starts.cost)} starts agree")
    if estimate.remnant:
        parts.append(_remnant_words(estimate.remnant))
    if estimate.frequency_response is not None and estimate.frequency_response.note:
        parts.append(estimate.frequency_response.note)
    if timed and math.isfinite(estimate.seconds):
        parts.append(f"{estimate.seconds:.2g} s")
    return f"{estimate.method}: {'; '.join(parts)}"


def _remnant_words(remnant: RemnantEstimate) -> str:
    """The remnant in a few words; the coefficients of a free spectrum say nothing to a reader."""
    words = f"remnant {100.0 * remnant.power_ratio:.1f} % of the control's power, {remnant.model}"
    if "frequency" in remnant.parameters:
        words += f" low-pass at {remnant.parameters['frequency']:.3g} rad/s"
    if "damping" in remnant.parameters:
        words += f", damping {remnant.parameters['damping']:.2g}"
    return words


def decimals(error: float) -> int:
    """Decimals of a number whose error shows two digits."""
    return min(max(1 - math.floor(math.log10(error)), 0), 9)


def figures(quantity: Quantity, plus_minus: str = "±") -> tuple[str, str]:
    """Value with standard error, and 95 % interval, to the digits that the error allows."""
    if not math.isfinite(quantity.value):
        return "-", ""
    error = quantity.std_error
    if not (math.isfinite(error) and error > 0.0):
        return f"{quantity.value:.4g}", ""
    digits = decimals(error)
    value = f"{quantity.value:.{digits}f} {plus_minus} {error:.{digits}f}"
    return value, f"{quantity.lower:.{digits}f} .. {quantity.upper:.{digits}f}"


# ----------------------------------------------------------------------------------- tables


def make_console(*, errors: bool = False) -> Console:
    """A console that neither colours nor breaks lines where it does not face a terminal."""
    from rich.console import Console

    console = Console(stderr=errors, highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console = Console(
            stderr=errors, highlight=False, markup=False, emoji=False, width=PLAIN_WIDTH
        )
    return console


def make_table() -> Table:
    """An empty table in the style of all tables here."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    return Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)


def print_table(console: Console, table: RenderableType) -> None:
    """Print without the spaces that fill each line up to the console's width."""
    if console.is_terminal:
        console.print(table)
        return
    with console.capture() as captured:
        console.print(table)
    lines = [line.rstrip() for line in captured.get().splitlines()]
    console.file.write("\n".join(lines).strip("\n") + "\n")


def progress(items: Iterable[T], what: str, total: int) -> Iterator[T]:
    """The items, with a bar on standard error while they come, if that is a terminal."""
    from rich.progress import track

    console = make_console(errors=True)
    hidden = not console.is_terminal or total < 2
    yield from track(items, what, total, console=console, transient=True, disable=hidden)


def print_fits(console: Console, fits: Sequence[Fit]) -> None:
    """Print the tables of several fits."""
    for i, fit in enumerate(fits):
        if i:
            console.print()
        print_fit(console, fit)


def print_fit(console: Console, fit: Fit) -> None:
    """Print the tables of a fit, and a line for each method."""
    console.print(heading(fit), style="bold", soft_wrap=True)
    usable = [e for e in fit.estimates if np.isfinite(e.values).any()]
    for group in _groups(usable, console.width):
        console.print()
        print_table(console, fit_table(group, "±" if console.encoding == "utf-8" else "+-"))
    console.print()
    for estimate in fit.estimates:
        style = None if estimate.outcome.usable else "red"
        console.print(verdict(estimate), style=style, soft_wrap=True)


def fit_table(estimates: Sequence[Estimate], plus_minus: str = "±") -> Table:
    """A row for each parameter, two columns for each estimate."""
    table = make_table()
    table.add_column("parameter", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for estimate in estimates:
        table.add_column(estimate.method, justify="right", no_wrap=True)
        table.add_column("95 % interval", justify="right", no_wrap=True)
    columns = [[*parameters(e), *derived(e)] for e in estimates]
    for row in zip(*columns, strict=True):
        cells = [cell for quantity in row for cell in figures(quantity, plus_minus)]
        table.add_row(row[0].key, row[0].unit, *cells)
    return table


def _groups(estimates: Sequence[Estimate], width: int) -> list[Sequence[Estimate]]:
    """As many estimates side by side as the width allows."""
    # Beside the two columns in front, an estimate takes some 40 characters.
    size = max(1, (width - 20) // 40)
    return [estimates[i : i + size] for i in range(0, len(estimates), size)]
