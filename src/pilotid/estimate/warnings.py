"""Why a model cannot be identified from a recording, and warnings about an estimate.

Methods object for the reasons; the codes of warnings are `pilotid.support.remarks.CODES`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pilotid.checks.checks import motionless, remarks
from pilotid.checks.element_fit import closing_element
from pilotid.checks.plant import is_gain
from pilotid.estimate.estimate import Estimate, Outcome, at_bounds
from pilotid.estimate.quantities import spans_decade
from pilotid.model.catalogue import fault_of
from pilotid.model.channel import STEEP
from pilotid.model.element import parsed_element
from pilotid.model.factors import Neuromuscular
from pilotid.model.loops import is_stable, pilot_on
from pilotid.model.model import PilotModel
from pilotid.recording.contents import listed
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import (
    NotMultisineError,
    at_lines,
    forcing_lines,
    jumps_of,
    known_lines,
    told_apart,
)
from pilotid.support.limits import ESTIMATE, SIGNAL
from pilotid.support.remarks import Grade, Remark, codes_of, remark_of
from pilotid.support.types import ComplexArray, FloatArray, InputError

# -------------------------------------------------------------------------------------- objections

CLEAR = 4.0  # times its noise that an extra signal's power at lines must be
#: What to do where channels cannot be told apart.
REMEDY = "record with a target and a disturbance, or fit one channel"


def motionless_input(recording: Recording, model: PilotModel) -> str | None:
    """Why no method can identify a model: a channel has nothing to act on, or is infinite."""
    if fault := fault_of(model):
        return fault
    if model.needs_element:
        named = recording.controlled_element
        return (
            f"model {model.name} is made for a controlled element with a stable inverse, and the "
            f"recording names {named or 'none'}; name one, for example --element 4/s^2"
        )
    if missing := unrecorded(recording, model):
        return missing
    for channel in model.channels:
        if (
            is_absent(recording, recording.input("ft"), recording.e)
            if channel.on == "ft"
            else motionless(recording, channel.on)
        ):
            return f"{channel.on} does not move, so that the {channel.name} channel has no input"
    return None


def unrecorded(recording: Recording, model: PilotModel) -> str | None:
    """Why no method at all can treat a model: what it acts on, or sees ahead, was not recorded.

    A target is known from e and x as well.
    """
    known = {*recording.signals, *(("ft",) if {"e", "x"} <= set(recording.signals) else ())}
    missing = [channel.on for channel in model.channels if channel.on not in known]
    if missing:
        return (
            f"model {model.name} acts on what is not recorded ({listed(dict.fromkeys(missing))}); "
            f"name the column, for example --map {missing[0]}=COLUMN, or choose another model"
        )
    if model.ahead <= 0.5 * recording.duration:
        return None
    return (
        f"model {model.name} looks up to {model.ahead:g} s ahead, and so much of the end of "
        f"{recording.duration:.3g} s cannot be scored, since the target beyond it is not recorded; "
        "bound the look-ahead, for example --fix tlook=0..2"
    )


def made_for(recording: Recording, model: PilotModel) -> PilotModel:
    """A model for the controlled element that a recording names; one that needs none as it is.

    It stays as it is, too, where no element is named that a pilot can invert.
    """
    element = parsed_element(recording.controlled_element) if model.needs_element else None
    try:
        return model if element is None else model.with_element(element)
    except InputError:
        return model


def shared_signals(recording: Recording, model: PilotModel) -> str | None:
    """Why channels can hardly be told apart: their signals depend on one another."""
    inputs = {channel.on for channel in model.channels} - {*model.extra}
    if "ft" not in inputs or len(inputs) < 2:
        return one_signal(recording, model)
    if dependent := dependent_signals(model):
        return dependent
    if recording.fd is not None and not is_absent(recording, recording.fd, recording.u):
        return None
    return _alike(model, "no disturbance is recorded")


def _alike(model: PilotModel, why: str, cure: str = REMEDY) -> str:
    names = " and ".join(channel.name for channel in model.channels)
    return f"{why}, so that nothing but their form tells the {names} channels apart; {cure}"


def dependent_signals(model: PilotModel) -> str | None:
    """Why no response of each channel can be measured: they act on e, x and ft, which is e + x."""
    if not {channel.on for channel in model.channels} >= {"e", "x", "ft"}:
        return None
    return _alike(model, "three channels act on two signals, as ft = e + x", "fit two channels")


def varying(model: PilotModel) -> str | None:
    """Why a method of constant pilots cannot treat a model: its parameters vary in time."""
    if not model.changes:
        return None
    return f"model {model.name} varies in time, and this method assumes that it does not; use mle"


def element_unknown(recording: Recording) -> str | None:
    """Why a method that closes the loop cannot treat a recording: nothing tells its element."""
    if closing_element(recording) is not None:
        return None
    return "the controlled element is not known: name it, for example --element 4/s^2"


def looking_ahead(model: PilotModel) -> str | None:
    """Why a method of causal systems cannot treat a model: it sees the target ahead."""
    if not model.ahead:
        return None
    return f"model {model.name} looks ahead, which this method cannot do; use mle or fourier"


def one_signal(recording: Recording, model: PilotModel) -> str | None:
    """Why channels on error and output can hardly be told apart: there is no target."""
    both = {channel.on for channel in model.channels} >= {"e", "x"}
    if not both or not is_absent(recording, recording.e + recording.x, recording.e):
        return None
    return _alike(model, "two channels act on one signal, as without a target e = -x")


def black_box_objection(recording: Recording, model: PilotModel) -> str | None:
    """Why lagged signals do not tell a pilot: he changes, looks ahead, or has one input."""
    unsuited = varying(model) or looking_ahead(model) or dependent_signals(model)
    unsuited = unsuited or one_signal(recording, model)
    if unsuited or not is_gain(recording):
        return unsuited
    return (
        "the output follows the control at once (the controlled element is a gain), so that a "
        "black box finds the control in its own inputs"
    )


def is_absent(recording: Recording, forcing: FloatArray, beside: FloatArray) -> bool:
    """Whether a forcing function is no more than rounding errors beside another signal."""
    size = np.std(recording.window(beside), axis=1)
    return not np.any(np.std(recording.window(forcing), axis=1) > SIGNAL.motionless_forcing * size)


def lines_objection(recording: Recording, model: PilotModel) -> str | None:
    """Why the forcing functions have no lines, or too few, for the model's channels; or None."""
    if constant_only := varying(model):
        return constant_only
    try:
        lines = forcing_lines(recording)
    except NotMultisineError as error:
        return str(error)
    if not lines:
        return "the recording holds neither ft or fd nor their lines"
    inputs = [channel.on for channel in model.channels]
    if len(set(inputs)) < len(inputs):
        return f"model {model.name} has two channels on one input, which no lines tell apart"
    if inputs == ["ft"]:
        return f"model {model.name} acts on the target alone, outside any loop"
    if dependent := dependent_signals(model):
        return dependent
    every = np.concatenate(list(lines.values()))
    for name in model.extra:
        values, noise = at_lines(recording, recording.input(name), every, lines)
        if np.mean(np.abs(values) ** 2) < CLEAR * np.mean(noise):
            return f"{name} does not follow the forcing functions: their lines do not tell it"
    if len(inputs) > 2 or (model.extra and "ft" in inputs):
        return f"{listed(inputs)} are more inputs than two forcing functions tell apart"
    if len(inputs) == 2 and len(lines) < 2:
        return "two channels need both a target and a disturbance forcing function"
    if len(inputs) == 2 and not told_apart(recording):
        return "two channels need forcing functions without common lines in a run"
    if min(line.size for line in lines.values()) < 2:
        return "a forcing function has a single line, where two or more are needed"
    if 2 * every.size < len(model.parameters):
        return f"{every.size} lines are too few for {len(model.parameters)} parameters"
    return None


# --------------------------------------------------------------------- what is said of an estimate


#: Codes of what a recording leaves open, which is no fault of recording, model or fit.
LEFT_OPEN = ("inseparable", "not-determined")


LONGEST_TOLD = 300  # characters of remarks that a study keeps of a fit
ZERO_VAF = 0.05  # %, of a VAF that is shown as 0.0 %


def told(recording: Recording, estimate: Estimate) -> str:
    """What a user would be told against a recording and an estimate, on one line.

    Remarks on the recording come first and begin with ``recording:``, as `pilotid fit` has them.
    What a sound recording leaves open, such as a gain and a lead that trade off, is left out.
    """
    own = [remark for remark in estimate.remarks if codes_of([remark])[0] not in LEFT_OPEN]
    line = " | ".join([*(f"recording: {remark}" for remark in remarks(recording)), *own])
    return line if len(line) <= LONGEST_TOLD else f"{line[: LONGEST_TOLD - 4]} ..."


def all_remarks(estimate: Estimate, recording: Recording) -> tuple[Remark, ...]:
    """What a user must know of an estimate, also for what the recording lacks."""
    low = estimate.outcome.usable and estimate.vaf < ESTIMATE.least_vaf
    said = remarks_on(estimate, explained_of_forced(recording, estimate) if low else None)
    if estimate.outcome is Outcome.NOT_APPLICABLE:
        return said
    # Intervals hold all optima that are as likely: of 38 such fits by `mle` two were wrong, and
    # these had a doubt besides.
    why = shared_signals if is_vague(estimate) else one_signal
    shared = why(recording, estimate.model)
    both = (Remark("inseparable", shared) if shared else None, _jumps(estimate, recording))
    return (*said, *(remark for remark in both if remark))


def _jumps(estimate: Estimate, recording: Recording) -> Remark | None:
    """That nobody knows when between two samples a target jumps, where errors are far below."""
    errors = estimate.std_error[list(estimate.model.delays)]
    if not estimate.outcome.usable or not (errors < ESTIMATE.of_sample * recording.dt).any():
        return None
    if not jumps_of(recording).any():
        return None
    return Remark(
        "late-signal",
        f"the target jumps, at a sample or up to {1e3 * recording.dt:.3g} ms before it: delays are "
        "as uncertain, which moves all other values beyond their errors; use a target that a "
        "filter has smoothed",
        "doubt",
    )


def remarks_on(estimate: Estimate, explained: float | None = None) -> tuple[Remark, ...]:
    """The method's own remarks, and those that its numbers call for.

    `explained` is the share of the control that the model explains [%] where that is known better
    than by the VAF: a slow remnant that the loop suppresses is larger than the control it is in.
    """
    own = [remark_of(remark) for remark in estimate.remarks]
    if not estimate.outcome.usable:
        return tuple(own)
    hidden = (explained or 0.0) >= ESTIMATE.surely_explained
    explained = estimate.vaf if explained is None else explained
    in_band = 100.0 * (1.0 - estimate.remnant.power_ratio) if estimate.remnant else 0.0
    if explained < ESTIMATE.least_vaf and in_band < ESTIMATE.surely_explained:
        sentence = (
            f"the model explains at most {max(explained, estimate.vaf):.1f} % of the control, so "
            "the values mean nothing: check whether u, e and x belong together (one shifted in "
            "time, a wrong name, a wrong sign), or choose another model"
        )
        return (*own, Remark("little-explained", sentence))
    if explained < ESTIMATE.least_vaf:
        sentence = (
            f"the model explains {in_band:.0f} % of the control in the analysed band, and "
            f"{estimate.vaf:.1f} % of all frequencies: noise of the recorder in e or x passes above"
        )
        own.append(Remark("little-explained", sentence, "note"))
    elif estimate.vaf < ZERO_VAF:
        sentence = (
            "the simulated response explains nothing of the control (VAF 0 %): a slow remnant "
            f"hides it{'' if hidden else ', or the model is wrong'}; compare with other methods"
        )
        own.append(Remark("little-explained", sentence, "note" if hidden else "doubt"))
    return (
        *own,
        *_steps(estimate),
        *_outside_range(estimate),
        *(Remark("inseparable", pair.words) for pair in estimate.inseparable),
        *_not_determined(estimate),
    )


def is_vague(estimate: Estimate) -> bool:
    """Whether a fit failed, or leaves a parameter poorly identified."""
    far = estimate.std_error > ESTIMATE.vague * np.abs(estimate.values)
    return not estimate.outcome.usable or bool(far.any())


def explained_of_forced(recording: Recording, estimate: Estimate) -> float | None:
    """Share that a model explains [%] of the control at the lines of the forcing functions.

    It is that in its loop with the controlled element, which suppresses a slow remnant, where one
    is known.  Without lines it is that of all of the control in the loop; None for time-varying
    pilots, and where there are neither lines nor a stable loop.
    """
    model = estimate.model
    if model.changes:
        return None
    element = None if model.extra else closing_element(recording)
    lines = list(known_lines(recording).values())
    if not lines and (element is None or not is_stable(model, estimate.values, element)):
        return None
    used = np.unique(np.concatenate(lines)) if lines else np.arange(2, recording.samples // 2)
    # What the ends of a window leak, of a slow remnant as well, hides what the model explains.
    taper = np.hanning(recording.samples)

    def transformed(name: str) -> ComplexArray:
        signal = recording.window(recording.input(name))
        centred = signal - signal.mean(axis=1, keepdims=True)
        return np.asarray(np.fft.rfft(centred * taper)[:, used])

    control = transformed("u")
    left = control.copy()
    omega = np.asarray(2.0 * np.pi / recording.duration * used, dtype=float)
    responses = model.response(omega, estimate.values)
    for channel, response in zip(model.channels, responses, strict=True):
        left -= channel.sign * response * transformed(channel.on)
    if element is not None:
        left /= 1.0 + element.response(omega) * sum(pilot_on(model, omega, estimate.values))
    powers = np.sum(np.abs(left) ** 2), np.sum(np.abs(control) ** 2)
    return 100.0 * max(0.0, 1.0 - float(powers[0] / powers[1]))


def _steps(estimate: Estimate) -> Iterator[Remark]:
    """A change of a time-varying pilot that the recording cannot tell from a step."""
    model = estimate.model
    if not model.changes or estimate.values[model.change[1]] <= STEEP:
        return
    middle, rate = model.change
    channel = next(channel for channel in model.channels if channel.changing)
    yield Remark(
        "not-determined",
        f"the {channel.name} channel changes in a step at {estimate.values[middle]:.4g} s: "
        f"{model.keys[rate]} above {STEEP:g} 1/s means no more than fast",
    )


def _outside_range(estimate: Estimate) -> Iterator[Remark]:
    """Values beyond all bounds, delays and neuromuscular systems that people do not have."""
    least = dict[str, float]()
    for factor, _ in estimate.model.moving:
        if isinstance(factor, Neuromuscular):
            least[factor.damping_key] = ESTIMATE.least_damping
            least[factor.frequency_key] = ESTIMATE.least_frequency
    shortest, longest = ESTIMATE.shortest_delay, ESTIMATE.longest_delay
    for i, p in enumerate(estimate.model.parameters):
        value, (low, high) = float(estimate.values[i]), estimate.intervals[i].tolist()
        grade: Grade = "doubt"
        if not p.lower <= value <= p.upper:  # of a method without bounds
            words = f"outside {p.lower:g} to {p.upper:g}, where no pilot is: give another --start"
        elif p.delay and value < shortest:
            grade = "note" if high > shortest else "doubt"
            words = (
                f"at most {high:.3g}, but people's delays are not below {shortest:g} s: another "
                "parameter may have taken its part (a lag, a slow neuromuscular system), or u was "
                "recorded early"
            )
        elif p.delay and low > longest:
            words = (
                f"at least {low:.3g}, but people's delays are not above {longest:g} s: try a model "
                "without that channel"
            )
        elif value < least.get(p.key, -math.inf) and estimate.determined[i]:
            words = (
                f"but that of people's neuromuscular systems is not below {least[p.key]:g}: a "
                "resonance of the remnant or a lag may have taken the place of the system; compare "
                f"with --fix {p.key}={p.start:g}"
            )
        else:
            continue
        number = f"{value:.3g} {p.unit}".strip()
        yield Remark("outside-range", f"{p.key} is {number}, {words}", grade)


def _not_determined(estimate: Estimate) -> Iterator[Remark]:
    """Parameters with an interval that ends at a bound, or is wide: a remark of each grade."""
    doubts, notes = list[str](), list[str]()
    is_low, is_high = at_bounds(estimate.model, *estimate.intervals.T)
    for i, p in enumerate(estimate.model.parameters):
        value, (low, high) = float(estimate.values[i]), estimate.intervals[i].tolist()
        unit, (least, most) = f" {p.unit}" if p.unit else "", p.usual
        is_short = p.delay and value < ESTIMATE.shortest_delay
        if not p.lower <= value <= p.upper or (is_short and not is_high[i]):
            continue  # `_outside_range` says so
        if is_low[i] and is_high[i]:
            notes.append(f"{p.key} may have any value from {p.lower:g} to {p.upper:g}{unit}")
        elif is_low[i] or is_high[i]:
            side, end, bound = ("most", high, p.lower) if is_low[i] else ("least", low, p.upper)
            words = f"{p.key} is at {side} {end:.3g}{unit}"
            # A lead or lag that is next to none is no wonder; one beyond all that is published is.
            strange = end > most if is_high[i] else end < least and p.unit != "s"
            if math.isclose(end, bound, rel_tol=1e-3):
                doubts.append(f"{p.key} is at its bound {bound:g}{unit}")
            elif strange and not p.linear:
                doubts.append(f"{words}, and {least:g} .. {most:g} are published")
            else:
                notes.append(words)
        elif p.positive and spans_decade(low, high):
            notes.append(f"{p.key} is {low:.2g} .. {high:.2g}{unit}")
    if doubts:
        why = "the model may be wrong, or a bound too tight"
        yield Remark("not-determined", f"{'; '.join(doubts)}: {why}", "doubt")
    if notes:
        yield Remark("not-determined", f"{'; '.join(notes)}: the recording does not tell more")
