"""The error is the target less the output: signs, units and names that tell."""

from __future__ import annotations

import numpy as np

from pilotid.recordings.lines import NotMultisineError, at_lines, forcing_lines, target_lines
from pilotid.recordings.recording import Recording
from pilotid.remarks import Remark
from pilotid.types import FloatArray

IDENTITY = 0.01  # rms of e - (ft - x) over that of e; recordings reach 3e-6
SHOWN = 0.5  # share of the target's fast lines that the error must show
SCALED = 0.02  # by which a factor between signals must differ from 1 to be one of units
SAME = 0.01  # by which it may differ from line to line


def not_the_error(recording: Recording) -> Remark | None:
    """The error of a compensatory task is the target less the output."""
    if recording.ft is None:
        return _without_target(recording)
    e, x, ft = (recording.window(s) for s in (recording.e, recording.x, recording.ft))
    size = _rms(e)
    off = _rms(e - (ft - x))
    if off <= IDENTITY * size or size == 0.0:
        return None
    for code, what, trial, advice in (
        ("wrong-sign", "e has the wrong sign", -e - (ft - x), _flip(recording, "e")),
        ("wrong-sign", "x has the wrong sign", e - (ft + x), _flip(recording, "x")),
        ("wrong-sign", "ft has the wrong sign", e - (-ft - x), _flip(recording, "ft")),
        (
            "not-the-error",
            "e and ft - x differ by a constant",
            _centred(e - (ft - x)),
            "remove the offset",
        ),
    ):
        if _rms(trial) <= IDENTITY * size:
            return Remark(code, f"e is not ft - x: {what}; {advice}")
    for name, wanted, given in (("x", ft - e, x), ("e", ft - x, e), ("ft", e + x, ft)):
        factor = float(np.sum(wanted * given) / (np.sum(given**2) or 1.0))
        if _rms(wanted - factor * given) <= IDENTITY * _rms(wanted) and factor:
            return Remark("wrong-unit", f"e is not ft - x: {_scaled(name, factor)}")
    return Remark(
        "not-the-error",
        f"e is not ft - x: they differ by {100.0 * off / size:.3g} % of e; check signs, units and "
        "the names that --map gives",
    )


def _without_target(recording: Recording) -> Remark | None:
    """What the disturbance does to the output it does to the error, with the other sign."""
    factor = _at_disturbance(recording)
    if factor is None or abs(factor - 1.0) <= SCALED:
        return None
    if abs(factor + 1.0) <= SCALED:
        return Remark(
            "wrong-sign",
            "e and x have the same sign at the lines of fd, though e = ft - x; flip one of them, "
            f"with --map {recording.flipped('e')} or --map {recording.flipped('x')}",
        )
    return Remark("wrong-unit", f"e is not -x at the lines of fd: {_scaled('x', factor)}")


def _at_disturbance(recording: Recording) -> float | None:
    """What x must be multiplied with to be -e at the lines of fd; None if they do not tell."""
    try:
        every = forcing_lines(recording)
    except NotMultisineError:
        return None
    if "fd" not in every:
        return None
    error, output = (
        np.fft.rfft(recording.window(signal))[:, every["fd"]]
        for signal in (recording.e, recording.x)
    )
    if not np.abs(output).all():
        return None
    # Remnant and transients are in both alike; a target that is no multisine makes them differ.
    factors = -error / output
    middle = float(np.median(factors.real))
    off = float(np.median(np.abs(factors - middle)))
    return middle if off <= SAME * abs(middle) else None


def _scaled(name: str, factor: float) -> str:
    for ratio, units in ((180.0 / np.pi, "radians"), (np.pi / 180.0, "degrees")):
        if abs(factor / ratio - 1.0) <= IDENTITY:
            other = "degrees" if units == "radians" else "radians"
            return f"{name} is in {units} and the others are in {other}; convert it"
    return (
        f"{name} is {1.0 / factor:.4g} times what the others make it, so the units differ; give "
        "all in one unit"
    )


def units_differ(recording: Recording) -> Remark | None:
    """Units that the file gives must be one for error, output and target."""
    given = {n: u for n in ("e", "x", "ft") if (u := recording.units.get(n)) and n != u}
    if len(set(given.values())) < 2:
        return None
    words = ", ".join(f"{name} in {unit}" for name, unit in given.items())
    return Remark(
        "wrong-unit",
        f"the file gives {words}; e = ft - x takes one unit: convert, or correct what it says",
    )


def exchanged(recording: Recording) -> Remark | None:
    """A loop cannot follow the fast lines of a target, so that the error shows all of them."""
    lines = target_lines(recording)
    if lines is None or recording.ft is None:
        return None
    fast = lines["ft"][lines["ft"].size // 2 :]
    error, noise = at_lines(recording, recording.e, fast, lines)
    target = np.fft.rfft(recording.window(recording.ft))[:, fast]
    weight = np.abs(target) ** 2 / noise
    shown = float(np.sum(weight * np.real(error / target)) / np.sum(weight))
    if shown >= SHOWN:
        return None
    return Remark(
        "exchanged",
        f"e shows {100.0 * shown:.0f} % of the fast lines of the target, which no loop follows: e "
        "and x seem to be exchanged; correct the names with --map "
        f"e={recording.origin.get('x', 'x')},x={recording.origin.get('e', 'e')}",
    )


def _flip(recording: Recording, name: str) -> str:
    return f"flip it with --map {recording.flipped(name)}"


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def _centred(signal: FloatArray) -> FloatArray:
    return np.asarray(signal - signal.mean(axis=1, keepdims=True))
