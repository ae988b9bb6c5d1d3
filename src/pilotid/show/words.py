"""The summary of a recording's fits in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pilotid.estimates.estimate import Estimate, Outcome, is_at_bound
from pilotid.estimates.fitted import Fitted
from pilotid.estimates.quantities import Quantity
from pilotid.recordings.recording import INPUTS
from pilotid.show.named import leading

#: Half of a 95 % interval over the value up to which a parameter is well known, and from which
#: on it is poorly known.
WELL, POORLY = 0.1, 0.5


def summary(fit: Fitted) -> list[str]:
    """What was fitted, how well, what is known, and whether methods agree: a sentence each."""
    sentences = [_what(fit), *_outcomes(fit.estimates)]
    chosen = leading(fit.estimates)
    if chosen is not None:
        sentences += _how_well(chosen)
        if chosen.outcome.usable:
            sentences += [*_known(chosen), *_agreement(chosen, fit.estimates)]
        else:
            sentences.append("No numbers here are to be used.")
    count = len(fit.warnings)
    if count:
        remarks = "One remark below says" if count == 1 else f"{count} remarks below say"
        sentences.append(f"{remarks} what to know before the numbers are used.")
    elif chosen is not None:
        sentences.append("No test spoke against recording or fit.")
    return sentences


def listed(words: Sequence[str]) -> str:
    """Words with commas, and an ``and`` before the last."""
    return " and ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)


def _what(fit: Fitted) -> str:
    recording, model = fit.recording, fit.model
    channels = [f"a {c.name} channel on {INPUTS[c.input]}" for c in model.channels]
    runs = "one run" if recording.runs == 1 else f"{recording.runs} runs together, each"
    return (
        f"The pilot model {model.name} ({listed(channels)}; {len(model.parameters)} parameters) "
        f"was fitted to {runs} of {recording.duration:.4g} s at {1.0 / recording.dt:.4g} Hz, by "
        f"{listed([e.method for e in fit.estimates])}."
    )


def _outcomes(estimates: Sequence[Estimate]) -> list[str]:
    good = [e.method for e in estimates if e.outcome is Outcome.CONVERGED]
    others = [f"{e.method} {e.sentence}" for e in estimates if e.method not in good]
    if not others:
        return ["The fit converged." if len(good) == 1 else "All fits converged."]
    return [f"{listed(good)} converged."] * bool(good) + [f"{other}." for other in others]


def _how_well(chosen: Estimate) -> list[str]:
    if not math.isfinite(chosen.vaf):
        return []
    told = (
        f"The response of the model by {chosen.method} to the recorded inputs accounts for "
        f"{chosen.vaf:.1f} % of the variance of the control"
    )
    if chosen.remnant is not None:
        told += f"; {chosen.remnant.words}"
    return [f"{told}."]


def _known(chosen: Estimate) -> list[str]:
    there = is_at_bound(chosen.model, chosen.values)
    bound = [key for key, at_bound in zip(chosen.model.keys, there, strict=True) if at_bound]
    shares = {q.key: _share(q) for q in chosen.quantities if not set(q.key.split("*")) & set(bound)}
    if not all(math.isfinite(share) for share in shares.values()):
        return []
    well = [f"{key} (± {_percent(share)})" for key, share in shares.items() if share <= WELL]
    poorly = [f"{key} (± {_percent(share)})" for key, share in shares.items() if share >= POORLY]
    told = [
        f"{what} is {listed(keys)}"
        for what, keys in (
            ("well known (95 % interval within 10 %)", well),
            ("poorly known (beyond 50 %)", poorly),
            ("held by a bound", bound),
        )
        if keys
    ]
    if not (poorly or bound):
        told.append("nothing is poorly known (beyond 50 %)")
    return [f"By {chosen.method}, {'; '.join(told)}."]


def _share(quantity: Quantity) -> float:
    """Half of the interval over the value."""
    if quantity.value == 0.0:
        return math.inf
    return 0.5 * (quantity.upper - quantity.lower) / abs(quantity.value)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


def _agreement(chosen: Estimate, estimates: Sequence[Estimate]) -> list[str]:
    others = [
        e for e in estimates
        if e is not chosen and e.outcome.usable and np.isfinite(e.intervals).all()
    ]  # fmt: skip
    if not others or not np.isfinite(chosen.intervals).all():
        return []
    apart = []
    for other in others:
        gap = np.maximum(chosen.intervals[:, 0], other.intervals[:, 0]) > np.minimum(
            chosen.intervals[:, 1], other.intervals[:, 1]
        )
        if gap.any():
            keys = [key for key, far in zip(chosen.model.keys, gap, strict=True) if far]
            apart.append(f"{other.method} ({', '.join(keys)})")
    if not apart:
        return [f"The 95 % intervals of all methods overlap those of {chosen.method}."]
    return [f"95 % intervals that do not overlap those of {chosen.method}: {listed(apart)}."]
