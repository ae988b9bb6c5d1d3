"""Estimates in words."""

from __future__ import annotations

import math

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.quantities import Fitted
from pilotid.estimates.remnant import RemnantEstimate


def heading(fit: Fitted) -> str:
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
