"""What a design must keep: limits on e, u and x, on peaks, on the spectrum.

All are linear in the powers of the lines.  Limits on e, u, x and their rates are on variances,
the remnant's part included, as multiples of those under the reference's forcing functions;
powers are those of ft, and of fd at the control, where it enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from pilotid.designing.lines import SIGNALS, Lines, Loop, shares_like
from pilotid.designing.optimum import Limit
from pilotid.types import FloatArray, InputError

#: Crest factor that a limit on the peak of ft and fd allows for, and standard deviations that
#: one on the peaks of u and x does.
CREST, DEVIATIONS = 2.5, 3.0
#: Names of the limits on peaks in the loop, by signal.
PEAKS = {"u": "stick", "x": "travel", "dx": "velocity", "ddx": "acceleration"}


@dataclass(frozen=True)
class Limits:
    """Limits of a design.

    Attributes
    ----------
    e, u, de, du, x, dx, ddx
        Largest variance of error, control and their rates, and of output, its rate and its
        acceleration, over that of the reference; None for none.
    power
        Largest power of ft and of fd over that of the reference; their power if the remnant is a
        share of the control's.
    balance
        Whether ft and fd keep the ratio of their powers.
    shape
        Whether no share of a signal's power above any frequency may exceed the reference's.
    line
        Largest share of a signal's power at one line, or the reference's share where that is
        more.
    floor
        Least share of a signal's power at a line, as a multiple of the reference's there.
    high
        Largest share of a signal's power above 0.8 of the crossover frequency, where power lets
        pilots lower the crossover (McRuer and Jex 1967); None for none.
    each
        Whether variances keep their limits for each of several pilots, or in the mean over them;
        None for each if the worst pilot counts.
    above, beyond
        Largest share of a signal's power above a frequency [rad/s]; None for none.
    ft, fd, stick, travel, velocity, acceleration
        Largest peaks of ft, fd, u, x and the rate and acceleration of x [the signals' units];
        None for none.
    """

    e: float | None = None
    u: float | None = None
    de: float | None = None
    du: float | None = None
    x: float | None = None
    dx: float | None = None
    ddx: float | None = None
    power: float | None = 1.0
    balance: bool = True
    shape: bool = True
    line: float = 0.25
    floor: float = 0.1
    high: float | None = None
    above: float | None = None
    beyond: float | None = None
    ft: float | None = None
    fd: float | None = None
    stick: float | None = None
    travel: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    each: bool | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or value is None or field.name == "floor":
                continue
            if not (value > 0.0 and np.isfinite(value)):
                raise ValueError(f"{field.name} must be a number above 0")
        if not 0.0 <= self.floor < 1.0:
            raise ValueError("floor must be at least 0 and below 1")
        if (self.above is None) != (self.beyond is None):
            raise ValueError("above is a share of power and needs beyond, a frequency in rad/s")
        # Without any of these more power is always better.
        if all(getattr(self, n) is None for n in (*SIGNALS, *PEAKS.values(), "power", "ft")):
            raise ValueError("without a limit on power, e, u or x there is no best design")


def linear(
    limits: Limits,
    loops: Sequence[Loop],
    references: Sequence[Loop],
    powers: FloatArray,
    *,
    over: Literal["mean", "worst"] = "mean",
) -> list[Limit]:
    """The limits on the powers of the lines.

    Parameters
    ----------
    limits
        What is to be kept.
    loops, references
        One for each pilot, with the lines of the design and with those of the reference.
    powers
        Powers of the reference, shape (reference's lines,).
    over
        What counts of several pilots; see `Limits.each`.
    """
    if loops[0].control is not None and limits.power is None:
        raise InputError(
            "where the remnant is a share of the control's power, only ratios of powers count: "
            "give a limit on power"
        )
    lines, known = loops[0].lines, references[0].lines
    each = over == "worst" if limits.each is None else limits.each
    found = _of_variances(limits, loops, references, powers, each=each)
    whole = []
    for name, at in lines.signals:
        here = np.zeros(lines.omega.size)
        here[at] = 1.0
        power = float(powers[dict(known.signals)[name]].sum())
        whole.append(here / power)
        if limits.power is not None:
            # Where the remnant falls with the control, less power would cost nothing.
            used = loops[0].control is not None
            found.append(Limit(f"power={limits.power:g}", here / power, limits.power, equal=used))
        peak = getattr(limits, name)
        if peak is not None:
            found.append(Limit(f"{name}={peak:g}", here / (peak / CREST) ** 2, 1.0))
        shares = shares_like(known, powers, lines, name)
        found += _of_shares(limits, shares, here, power, at)
        found += _above(limits, lines, here, power, loops)
        if limits.shape:
            found += _shape(lines, shares, here / power, at)
    if limits.balance and len(whole) == 2:
        found.append(Limit("balance", whole[0] - whole[1], 0.0, equal=True))
    return found


def _of_variances(
    limits: Limits,
    loops: Sequence[Loop],
    references: Sequence[Loop],
    powers: FloatArray,
    *,
    each: bool,
) -> list[Limit]:
    found = []
    for signal, name in PEAKS.items():
        if getattr(limits, name) is not None:
            found += _of_peak(name, getattr(limits, name), signal, loops)
    for signal in SIGNALS:
        times = getattr(limits, signal)
        if times is None:
            continue
        name = f"{signal}={times:g}"
        usual = [reference.variance(signal, powers) for reference in references]
        pairs = list(zip(loops, usual, strict=True))
        rows = [loop.gains[signal] / own for loop, own in pairs]
        rooms = [times - loop.free[signal] / own for loop, own in pairs]
        if max(rooms) <= 0.0:
            alone = loops[0].free[signal] / usual[0]
            raise InputError(
                f"the limit {name} cannot be kept: the remnant alone makes the variance of "
                f"{signal} {alone:.2f} of the reference's"
            )
        if not each:
            rows, rooms = [np.mean(rows, axis=0)], [float(np.mean(rooms))]
        found += [Limit(name, row, room) for row, room in zip(rows, rooms, strict=True)]
    return found


def _of_peak(name: str, peak: float, signal: str, loops: Sequence[Loop]) -> list[Limit]:
    """A limit on so many standard deviations of a signal, for each pilot."""
    most = (peak / DEVIATIONS) ** 2
    least = max(loop.free[signal] for loop in loops)
    if least >= most:
        raise InputError(
            f"the limit {name}={peak:g} cannot be kept: {DEVIATIONS:g} standard deviations of what "
            f"the remnant alone causes are {DEVIATIONS * np.sqrt(least):.3g}"
        )
    return [
        Limit(f"{name}={peak:g}", loop.gains[signal] / most, 1.0 - loop.free[signal] / most)
        for loop in loops
    ]


def _of_shares(
    limits: Limits, shares: FloatArray, here: FloatArray, power: float, at: slice
) -> list[Limit]:
    """Ceilings and floors of the lines of one signal."""
    found = []
    for number, share in zip(range(at.start, at.stop), shares, strict=True):
        own = np.zeros(here.size)
        own[number] = 1.0
        most, least = max(limits.line, float(share)), limits.floor * float(share)
        if most < 1.0 and shares.size > 1:
            found.append(Limit(f"line={limits.line:g}", (own - most * here) / power, 0.0))
        if least > 0.0:
            found.append(Limit(f"floor={limits.floor:g}", (least * here - own) / power, 0.0))
    return found


def _above(
    limits: Limits, lines: Lines, here: FloatArray, power: float, loops: Sequence[Loop]
) -> list[Limit]:
    """Shares of power above a frequency."""
    wanted = []
    if limits.high is not None:
        least = min(loop.crossover for loop in loops)
        wanted.append((f"high={limits.high:g}", limits.high, 0.8 * least))
    if limits.above is not None and limits.beyond is not None:
        wanted.append((f"above={limits.above:g}", limits.above, limits.beyond))
    return [
        Limit(name, ((lines.omega > edge) - share) * here / power, 0.0)
        for name, share, edge in wanted
    ]


def _shape(lines: Lines, shares: FloatArray, whole: FloatArray, at: slice) -> list[Limit]:
    """No more of a signal's power above any line than a spectrum like the reference's has."""
    found = []
    for number in range(shares.size - 1):
        above = np.full(lines.omega.size, -float(shares[number + 1 :].sum()))
        above[at.start + number + 1 : at.stop] += 1.0
        # A hair of room: the reference itself is on all of these limits at once.
        found.append(Limit("shape", above * whole, 1e-6))
    return found
