"""Warnings about an estimate, whatever its method; see `pilotid.support.remarks.CODES`."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pilotid.estimate.applicability import one_signal, shared_signals
from pilotid.estimate.estimate import Estimate, Outcome, at_bounds
from pilotid.estimate.quantities import spans_decade
from pilotid.model.channel import STEEP
from pilotid.model.factors import Parameter
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import known_lines
from pilotid.support.limits import ESTIMATE
from pilotid.support.remarks import Remark, remark_of
from pilotid.support.types import ComplexArray

#: Codes of what a recording leaves open, which is no fault of recording, model or fit.
LEFT_OPEN = (
    "inseparable", "not-identifiable", "at-bound", "interval-at-bound", "wide-interval",
    "asymmetric-interval",
)  # fmt: skip


ZERO_VAF = 0.05  # %, of a VAF that is shown as 0.0 %


def all_remarks(estimate: Estimate, recording: Recording) -> tuple[Remark, ...]:
    """What a user must know of an estimate, also for what the recording lacks."""
    low = estimate.outcome.usable and estimate.vaf < ESTIMATE.least_vaf
    remarks = remarks_on(estimate, explained_of_forced(recording, estimate) if low else None)
    if estimate.outcome is Outcome.NOT_APPLICABLE:
        return remarks
    # Without a target the likelihood can have two optima, which no reported error shows.
    why = shared_signals if is_vague(estimate) else one_signal
    shared = why(recording, estimate.model)
    return (*remarks, Remark("shared-signals", shared)) if shared else remarks


def remarks_on(estimate: Estimate, explained: float | None = None) -> tuple[Remark, ...]:
    """The method's own remarks, and those that its numbers call for.

    `explained` is the share of the control that the model explains [%] where that is known better
    than by the VAF: a slow remnant that the loop suppresses is larger than the control it is in.
    """
    remarks = [remark_of(remark) for remark in estimate.remarks]
    if not estimate.outcome.usable:
        return tuple(remarks)
    explained = estimate.vaf if explained is None else explained
    if explained < ESTIMATE.least_vaf:
        sentence = (
            f"the model explains {explained:.1f} % of the control, so the values mean nothing: "
            "check whether u, e and x belong together (one shifted in time, a wrong name, a wrong "
            "sign), or choose another model"
        )
        return (*remarks, Remark("little-explained", sentence))
    if estimate.vaf < ZERO_VAF:
        sentence = (
            "the simulated response explains nothing of the control (VAF 0 %): a slow remnant "
            "hides it, or the model is wrong; compare with other methods and models"
        )
        remarks.append(Remark("little-explained", sentence, "doubt"))
    return (
        *remarks,
        *_steps(estimate),
        *_short_delays(estimate),
        *(Remark("inseparable", pair.words) for pair in estimate.inseparable),
        *_poorly_identified(estimate),
    )


def is_vague(estimate: Estimate) -> bool:
    """Whether a fit failed, or leaves a parameter poorly identified."""
    if not estimate.outcome.usable:
        return True
    return bool(np.any(estimate.std_error > ESTIMATE.vague * np.abs(estimate.values)))


def explained_of_forced(recording: Recording, estimate: Estimate) -> float | None:
    """Share that a model explains [%] of the control at the lines of the forcing functions.

    None for time-varying pilots, and without lines.
    """
    lines = [] if estimate.model.changes else list(known_lines(recording).values())
    if not lines:
        return None
    used = np.unique(np.concatenate(lines))

    def at_lines(name: str) -> ComplexArray:
        return np.asarray(np.fft.rfft(recording.window(recording.input(name)))[:, used])

    control = at_lines("u")
    left = control.copy()
    omega = 2.0 * np.pi / recording.duration * used
    responses = estimate.model.response(omega, estimate.values)
    for channel, response in zip(estimate.model.channels, responses, strict=True):
        left -= channel.sign * response * at_lines(channel.on)
    powers = np.sum(np.abs(left) ** 2), np.sum(np.abs(control) ** 2)
    return 100.0 * max(0.0, 1.0 - float(powers[0] / powers[1]))


def _steps(estimate: Estimate) -> Iterator[Remark]:
    """A change of a time-varying pilot that the recording cannot tell from a step."""
    model = estimate.model
    if not model.changes or estimate.values[model.change[1]] <= STEEP:
        return
    middle, rate = model.change
    channel = next(channel for channel in model.channels if channel.changing)
    least = float(estimate.intervals[rate, 0])
    bound = f", at least {least:.2g} 1/s" if np.isfinite(least) else ""
    yield Remark(
        "step-change",
        f"the {channel.name} channel changes in a step at {estimate.values[middle]:.4g} s: "
        f"{model.keys[rate]} above {STEEP:g} 1/s means no more than fast{bound}",
    )


def _short_delays(estimate: Estimate) -> Iterator[Remark]:
    """Delays that people do not have."""
    for i in estimate.model.delays:
        value, end = float(estimate.values[i]), float(estimate.intervals[i, 1])
        if value < ESTIMATE.shortest_delay:
            yield Remark(
                "short-delay",
                f"{estimate.model.keys[i]} is {value:.3g} s (at most {end:.3g}), but people's "
                f"delays are not below {ESTIMATE.shortest_delay:g} s: another parameter may have "
                "taken its part (a lag, a slow neuromuscular system), or u was recorded early",
                "note" if end > ESTIMATE.shortest_delay else "doubt",
            )


def _poorly_identified(estimate: Estimate) -> Iterator[Remark]:
    """Parameters with an interval that ends at a bound, is wide, or lies to one side."""
    model = estimate.model
    low, high = at_bounds(model, *estimate.intervals.T)
    wide, asymmetric = [], []
    for parameter, value, interval, is_low, is_high in zip(
        model.parameters, estimate.values, estimate.intervals, low, high, strict=True
    ):
        if not parameter.lower <= value <= parameter.upper:
            continue  # of a method without bounds, which says so itself
        if parameter.delay and value < ESTIMATE.shortest_delay and not is_high:
            continue  # `_short_delays` says so
        if is_low or is_high:
            yield _at_bound(parameter, interval.tolist(), is_low, is_high)
            continue
        ends = np.array([interval[0], value, interval[1]])
        if parameter.positive:
            if spans_decade(*interval):
                wide.append(f"{parameter.key} ({interval[0]:.2g} .. {interval[1]:.2g})")
                continue
            ends = np.log(ends)
        below, above = np.diff(ends)
        if max(below, above) > ESTIMATE.asymmetric * min(below, above):
            asymmetric.append(f"{parameter.key} ({'above' if above > below else 'below'})")
    if wide:
        yield Remark(
            "wide-interval",
            f"{', '.join(wide)} {'is' if len(wide) == 1 else 'are'} poorly identified: the 95 % "
            f"interval spans more than a factor of {ESTIMATE.wide:g}",
        )
    if asymmetric:
        yield Remark(
            "asymmetric-interval",
            f"the 95 % interval of {', '.join(asymmetric)} lies mostly on one side of the value: "
            "use the interval rather than the standard error",
        )


def _at_bound(parameter: Parameter, interval: list[float], is_low: bool, is_high: bool) -> Remark:
    key, unit = parameter.key, f" {parameter.unit}" if parameter.unit else ""
    if is_low and is_high:
        return Remark(
            "not-identifiable",
            f"{key} is not identifiable from this recording: its interval spans the whole allowed "
            f"range, {parameter.lower:g} .. {parameter.upper:g}{unit}",
        )
    side, end = ("most", interval[1]) if is_low else ("least", interval[0])
    bound = parameter.lower if is_low else parameter.upper
    if math.isclose(end, bound, rel_tol=1e-3):
        return Remark(
            "at-bound",
            f"{key} is at its bound {bound:g}{unit}: the model may be wrong, or the bound too "
            "tight",
        )
    words = (
        f"{key} is at {side} {end:.3g}{unit}, and the recording does not tell more: "
        f"its interval reaches the bound {bound:g}{unit}"
    )
    low, high = parameter.usual
    # A lead or lag that is next to none is no wonder; one beyond all that is published is.
    strange = end > high if is_high else end < low and parameter.unit != "s"
    if not strange or parameter.linear:
        return Remark("interval-at-bound", words)
    words += f"; {low:g} .. {high:g}{unit} are published, so it may stand for something else"
    return Remark("interval-at-bound", words, "doubt")
