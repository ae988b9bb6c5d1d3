"""Which lines the forcing functions may have."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from pilotid.datasets.forcing import Forcing, Multisine
from pilotid.datasets.scenarios import Scenario
from pilotid.types import FloatArray, InputError

Pick = Literal["any", "odd", "prime"]


@dataclass(frozen=True)
class Lines:
    """Lines of the target and of the disturbance, as multiples of 2 pi / period.

    Attributes
    ----------
    target, disturbance
        Ascending; empty for a signal that is not there.
    period
        Period of line 1 [s].
    """

    target: tuple[int, ...]
    disturbance: tuple[int, ...]
    period: float

    @property
    def omega(self) -> FloatArray:
        """Frequencies [rad/s], those of the target first, shape (lines,)."""
        both = np.array([*self.target, *self.disturbance], dtype=float)
        return np.asarray(2.0 * np.pi * both / self.period)

    @property
    def of_target(self) -> slice:
        """Where the target's lines are among all."""
        return slice(0, len(self.target))

    @property
    def of_disturbance(self) -> slice:
        """Where the disturbance's lines are among all."""
        return slice(len(self.target), len(self.target) + len(self.disturbance))

    @property
    def shared(self) -> bool:
        """Whether both signals have a line in common."""
        return bool(set(self.target) & set(self.disturbance))

    @property
    def signals(self) -> tuple[tuple[str, slice], ...]:
        """Name and place of each signal that is there."""
        both = ("ft", self.of_target), ("fd", self.of_disturbance)
        return tuple((name, at) for name, at in both if at.stop > at.start)


def multisine(scenario: Scenario, forcing: Forcing | None) -> Multisine | None:
    """A forcing function, if it is a multisine or none.

    Raises
    ------
    InputError
        If it is of another kind, or has no whole number of periods in the window.
    """
    if forcing is None:
        return None
    if not isinstance(forcing, Multisine):
        raise InputError(
            f"scenario {scenario.name}: a design starts from sums of sines, and this one has "
            "another kind of forcing function; name nominal, for example"
        )
    periods = scenario.duration / forcing.period
    if round(periods) < 1 or abs(periods - round(periods)) > 1e-9:
        raise InputError(
            f"scenario {scenario.name}: its window of {scenario.duration:g} s is no whole number "
            f"of periods of {forcing.period:g} s; a design needs that"
        )
    return forcing


def reference_lines(scenario: Scenario) -> Lines:
    """The lines that a scenario has."""
    target = multisine(scenario, scenario.target)
    disturbance = multisine(scenario, scenario.disturbance)
    periods = {f.period for f in (target, disturbance) if f is not None}
    if len(periods) != 1:
        raise InputError(
            f"scenario {scenario.name}: a design needs forcing functions of one period to start "
            "from; name nominal, for example"
        )
    return Lines(
        target.lines if target else (), disturbance.lines if disturbance else (), periods.pop()
    )


def chosen_lines(
    reference: Lines,
    count: int | None = None,
    pick: Pick = "any",
    period: float | None = None,
    *,
    shared: bool = False,
) -> Lines:
    """Lines over the frequencies of the reference, evenly on a logarithmic scale.

    Parameters
    ----------
    reference
        Lines that are kept where nothing else is asked for.
    count
        Lines of each signal; None for as many as the reference has.
    pick
        ``any``, ``odd`` (a pilot's even nonlinearity then answers between the lines) or
        ``prime`` lines (no line is a harmonic of another).
    period
        Period of line 1 [s], 2 pi over the base frequency; None for the reference's.
    shared
        Whether both signals have the same lines: by themselves the target's of the reference.

    Raises
    ------
    InputError
        If there are too few such lines.
    """
    if pick not in get_args(Pick):
        raise InputError(f"lines can be {', '.join(get_args(Pick))}, not {pick}")
    shared = shared and len(reference.signals) == 2
    if count is None and pick == "any" and period is None:
        return replace(reference, disturbance=reference.target) if shared else reference
    base = period or reference.period
    signals = 1 if shared else len(reference.signals)
    each = count or max(len(reference.target), len(reference.disturbance))
    low, high = (float(f(reference.omega)) * base / (2.0 * np.pi) for f in (np.min, np.max))
    allowed = [k for k in range(1, int(np.ceil(high)) + 1) if _is(k, pick)]
    if len(allowed) < each * signals:
        raise InputError(
            f"there are {len(allowed)} {pick} lines up to {np.max(reference.omega):.3g} rad/s with "
            f"a period of {base:g} s, fewer than {each * signals}; take fewer lines or a longer "
            "period"
        )
    lines: list[int] = []
    free = list(allowed)
    for wish in np.geomspace(low, high, each * signals):
        best = min(free, key=lambda k: abs(np.log(k / wish)))
        lines.append(best)
        free.remove(best)
    lines.sort()
    if signals == 1:
        both = tuple(lines)
        return Lines(both if reference.target else (), both if reference.disturbance else (), base)
    return Lines(tuple(lines[1::2]), tuple(lines[::2]), base)


def _is(line: int, pick: Pick) -> bool:
    if pick == "odd":
        return line % 2 == 1
    if pick == "prime":
        return line > 1 and all(line % k for k in range(2, int(line**0.5) + 1))
    return True


def shares_like(reference: Lines, powers: FloatArray, lines: Lines, at: str) -> FloatArray:
    """Shares of a signal's power on other lines that follow a reference's spectrum.

    The cumulative power over the logarithm of frequency is that of the reference.

    Parameters
    ----------
    reference, powers
        The reference's lines and their powers, shape (reference's lines,).
    lines
        The lines sought.
    at
        The signal, ``ft`` or ``fd``.

    Returns
    -------
    Shares that add up to 1, shape (the signal's lines,).
    """
    there, here = dict(reference.signals)[at], dict(lines.signals)[at]
    known, wanted = reference.omega[there], lines.omega[here]
    own = powers[there] / powers[there].sum()
    if known.size == wanted.size and np.allclose(known, wanted):
        return np.asarray(own)
    cumulative = np.concatenate([[0.0], np.cumsum(own)])
    shares = np.diff(np.interp(_edges(wanted), _edges(known), cumulative))
    shares = np.maximum(shares, 1e-6)
    return np.asarray(shares / shares.sum())


def _edges(omega: FloatArray) -> FloatArray:
    """Boundaries between the bands of lines on a logarithmic scale."""
    log = np.log(omega)
    if log.size == 1:
        return np.array([log[0] - 0.5, log[0] + 0.5])
    middle = 0.5 * (log[1:] + log[:-1])
    first, last = 2.0 * log[0] - middle[0], 2.0 * log[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])
