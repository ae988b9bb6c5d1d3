"""Faults of recorders put on simulated recordings: what is said of them, and what fits make of it.

    nox -s check -- recorder --scenario nominal,population-usual --recordings 20 --method mle

A row for each fault: codes that the detectors name, their median size, how often anything is
said (by the recording's remarks or the fit's), and of the fits that converged the root mean square
of errors over claimed errors, and coverage.  `sound` is the recording without a fault: what is said
there is a false alarm.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, lfilter, sosfilt, sosfilt_zi, sosfiltfilt

from pilotid.checks.checks import remarks
from pilotid.checks.detectors import findings
from pilotid.checks.element_fit import chosen_element
from pilotid.datasets import SCENARIOS, Scenario, scenario_named, simulate
from pilotid.datasets.population import drawn_forcing, drawn_pilot, drawn_remnant, reachable
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.model.catalogue import MODELS
from pilotid.model.element import ControlledElement
from pilotid.recording.recording import Recording
from pilotid.support.numbers import fit_rng, recording_rng, start_rng
from pilotid.support.remarks import remark_of
from pilotid.support.types import FloatArray, InputError

Rng = np.random.Generator
Fault = Callable[[Recording, Rng], Recording]
ALL = ("e", "u", "x", "ft", "fd")


def each(
    names: tuple[str, ...],
    change: Callable[[FloatArray, Recording, Rng], FloatArray],
) -> Fault:
    """A fault that changes some signals, one after the other."""

    def fault(recording: Recording, rng: Rng) -> Recording:
        there = {n: getattr(recording, n) for n in names}
        changed = {n: change(s, recording, rng) for n, s in there.items() if s is not None}
        return replace(recording, **changed)

    return fault


def late(seconds: float, *names: str) -> Fault:
    """Signals so much late, between the samples by interpolation of the spectrum."""

    def change(signal: FloatArray, recording: Recording, _: Rng) -> FloatArray:
        odd = np.concatenate([signal, 2 * signal[:, -1:] - signal[:, ::-1]], axis=1)
        trend = np.linspace(0.0, 1.0, odd.shape[1]) * (odd[:, -1:] - odd[:, :1])
        omega = 2.0 * np.pi * np.fft.rfftfreq(odd.shape[1], recording.dt)
        moved = np.fft.irfft(np.fft.rfft(odd - trend) * np.exp(-1j * omega * seconds), odd.shape[1])
        slope = trend[:, 1:2] / recording.dt
        return (moved + trend - slope * seconds)[:, : signal.shape[1]]

    return each(names, change)


def samples_late(count: int, *names: str) -> Fault:
    return each(names, lambda s, *_: np.concatenate([s[:, :1]] * count + [s[:, :-count]], axis=1))


def filtered(order: int, hertz: float, *names: str, causal: bool = False) -> Fault:
    def change(signal: FloatArray, recording: Recording, _: Rng) -> FloatArray:
        sections = butter(order, hertz, fs=1.0 / recording.dt, output="sos")
        if not causal:
            return np.asarray(sosfiltfilt(sections, signal, axis=1))
        start = sosfilt_zi(sections)[:, None] * signal[None, :, :1]
        return np.asarray(sosfilt(sections, signal, axis=1, zi=start)[0])

    return each(names, change)


def averaged(count: int, *names: str, causal: bool = False) -> Fault:
    def change(signal: FloatArray, _: Recording, __: Rng) -> FloatArray:
        padded = np.pad(signal, ((0, 0), (count, count)), mode="edge")
        found = lfilter(np.ones(count) / count, 1.0, padded, axis=1)
        ahead = 0 if causal else count // 2
        return np.asarray(found[:, count + ahead : count + ahead + signal.shape[1]])

    return each(names, change)


def resampled(count: int, how: str, *names: str) -> Fault:
    def change(signal: FloatArray, _: Recording, __: Rng) -> FloatArray:
        samples = np.arange(signal.shape[1])
        if how == "held":
            return np.asarray(signal[:, samples // count * count])
        from scipy.interpolate import make_interp_spline

        known = np.unique(np.append(samples[::count], samples[-1]))
        degree = 1 if how == "linear" else 3
        return np.asarray(make_interp_spline(known, signal[:, known], k=degree, axis=1)(samples))

    return each(names, change)


def noisy(share: float, *names: str, made: bool = False) -> Fault:
    """White noise of a share of the rms; the error made of the noisy output if `made`."""

    def change(signal: FloatArray, _: Recording, rng: Rng) -> FloatArray:
        return signal + share * np.std(signal) * rng.standard_normal(signal.shape)

    added = each(names, change)
    return together(added, _error_made) if made else added


def _error_made(recording: Recording, _: Rng) -> Recording:
    return replace(recording, e=target(recording) - recording.x)


def target(recording: Recording) -> FloatArray:
    return recording.e + recording.x if recording.ft is None else recording.ft


def rounded(size: float, *names: str, of: str = "peak") -> Fault:
    """Steps of a share of the signal's peak, or of the unit."""

    def change(signal: FloatArray, _: Recording, __: Rng) -> FloatArray:
        step = size * (float(np.abs(signal).max()) if of == "peak" else 1.0)
        return np.asarray(step * np.round(signal / (step or 1.0)))

    return each(names, change)


def lost(share: float, *names: str, how: str = "previous") -> Fault:
    """Samples, the same of all signals, replaced by the one before or by interpolation."""

    def fault(recording: Recording, rng: Rng) -> Recording:
        gone = rng.random(recording.u.shape[1]) < share
        gone[[0, -1]] = False
        gone[rng.integers(recording.run_in + 100, gone.size - 100)] = True
        samples = np.arange(gone.size)
        previous = np.maximum.accumulate(np.where(gone, 0, samples))
        changed = {}
        for name in names:
            signal = getattr(recording, name)
            if signal is None:
                continue
            changed[name] = (
                signal[:, previous]
                if how == "previous"
                else np.array([np.interp(samples, samples[~gone], row[~gone]) for row in signal])
            )
        return replace(recording, **changed)

    return fault


def spiked(size: float, *names: str) -> Fault:
    def change(signal: FloatArray, recording: Recording, rng: Rng) -> FloatArray:
        spiked, at = signal.copy(), rng.integers(recording.run_in, signal.shape[1], 3)
        spiked[:, at] += size * np.std(signal) * rng.choice([-1.0, 1.0], 3)
        return spiked

    return each(names, change)


def rows_dropped(count: int) -> Fault:
    """Rows missing from the file, its times made anew."""

    def fault(recording: Recording, rng: Rng) -> Recording:
        total = recording.u.shape[1]
        gone = rng.choice(np.arange(recording.run_in + 50, total - 50), count, replace=False)
        kept = np.delete(np.arange(total), gone)
        there = {n: getattr(recording, n) for n in ALL}
        return replace(
            recording, **{n: s[:, kept] for n, s in there.items() if s is not None}, lines={}
        )

    return fault


def times(factor: float, name: str) -> Fault:
    return each((name,), lambda s, *_: factor * s)


def together(*faults: Fault) -> Fault:
    def fault(recording: Recording, rng: Rng) -> Recording:
        for one in faults:
            recording = one(recording, rng)
        return recording

    return fault


def gap(seconds: float, how: str, *names: str) -> Fault:
    """A stretch of signals that is zero, the last value, or a straight line."""

    def fault(recording: Recording, rng: Rng) -> Recording:
        length = round(seconds / recording.dt)
        first = int(rng.integers(recording.run_in + 100, recording.u.shape[1] - length - 100))
        along = np.linspace(0.0, 1.0, length + 2)[1:-1]
        changed = {}
        for name in names:
            signal = getattr(recording, name).copy()
            begin, end = signal[:, first - 1, None], signal[:, first + length, None]
            filling = {"zero": 0.0 * begin, "last": begin, "linear": begin + along * (end - begin)}
            signal[:, first : first + length] = filling[how]
            changed[name] = signal
        return replace(recording, **changed)

    return fault


def _includes_fd(recording: Recording, _: Rng) -> Recording:
    return recording if recording.fd is None else replace(recording, u=recording.u + recording.fd)


def _copied(recording: Recording, _: Rng) -> Recording:
    rows = {n: np.concatenate([s, s]) for n in ALL if (s := getattr(recording, n)) is not None}
    return replace(recording, **rows)


def with_zero(rng: Rng) -> Scenario:
    """A pilot in front of an element with a zero."""
    while True:
        z, a, b = (round(float(v), 2) for v in rng.uniform((0.5, 1.5, 4.0), (3.0, 4.0, 15.0)))
        gain = float(f"{10.0 ** rng.uniform(-0.5, 1.5):.3g}")
        name = f"{gain}(s+{z})/(s(s^2+{a}s+{b}))"
        plant = ControlledElement((gain, gain * z), (1.0, a, b, 0.0), name=name)
        model = MODELS[str(rng.choice(["single", "lead-lag", "multi"]))]
        if (truth := drawn_pilot(model, plant, rng)) is None:
            continue
        target, disturbance = drawn_forcing(plant, 82.0, rng, aperiodic=False)
        scenario = replace(
            SCENARIOS["nominal"], name="zero", model=model, truth=tuple(truth.tolist()),
            element=plant, target=target, disturbance=disturbance, duration=82.0,
            dt=float(rng.choice([0.01, 0.02])), run_in=8.0,
            remnant=drawn_remnant(rng, exotic=False),
        )  # fmt: skip
        if reachable(scenario):
            return scenario


def bare(recording: Recording, *kept: str) -> Recording:
    """A recording with the forcing functions kept, and without the name of the element."""
    gone = {name: None for name in ("ft", "fd") if name not in kept}
    return replace(recording, **gone, lines={}, controlled_element="")


#: Faults by name, in the groups of a recorder's table.
FAULTS: dict[str, Fault] = {
    "sound": lambda recording, rng: recording,
    **{f"u late {1e3 * s:g} ms": late(s, "u") for s in (0.005, 0.01, 0.02, 0.04, 0.1, 0.3, 1.0)},
    **{f"u early {1e3 * -s:g} ms": late(s, "u") for s in (-0.01, -0.02, -0.1)},
    "u late a sample": samples_late(1, "u"),
    "e late a sample": samples_late(1, "e"),
    "x late a sample": samples_late(1, "x"),
    "ft late a sample": samples_late(1, "ft"),
    "fd late a sample": samples_late(1, "fd"),
    "u, fd late 2 samples": samples_late(2, "u", "fd"),
    "e, x, ft late a sample": samples_late(1, "e", "x", "ft"),
    "all held, every 2nd": resampled(2, "held", *ALL),
    "all held, every 5th": resampled(5, "held", *ALL),
    "all held, every 10th": resampled(10, "held", *ALL),
    "u held, every 2nd": resampled(2, "held", "u"),
    "u held, every 5th": resampled(5, "held", "u"),
    "e, x held, every 2nd": resampled(2, "held", "e", "x"),
    "all linear, every 5th": resampled(5, "linear", *ALL),
    "all linear, every 10th": resampled(10, "linear", *ALL),
    "u linear, every 5th": resampled(5, "linear", "u"),
    "all cubic, every 5th": resampled(5, "cubic", *ALL),
    **{f"all zero-phase {h:g} Hz": filtered(4, h, *ALL) for h in (1, 2, 3, 4, 5, 8, 10)},
    **{f"u zero-phase {h:g} Hz": filtered(4, h, "u") for h in (1, 2, 3, 5, 10)},
    **{f"all causal {h:g} Hz": filtered(4, h, *ALL, causal=True) for h in (1, 2, 3, 5)},
    **{f"u causal {h:g} Hz": filtered(4, h, "u", causal=True) for h in (2, 5, 10)},
    "u causal 2nd order 5 Hz": filtered(2, 5.0, "u", causal=True),
    "e, x, ft causal 5 Hz": filtered(4, 5.0, "e", "x", "ft", causal=True),
    "e = ft - filtered x": together(filtered(2, 5.0, "x", causal=True), _error_made),
    "u mean of 5": averaged(5, "u", causal=True),
    "u centred mean of 5": averaged(5, "u"),
    "u centred mean of 11": averaged(11, "u"),
    **{f"noise {s:g} on x": noisy(s, "x", made=True) for s in (1e-4, 1e-3, 1e-2, 5e-2)},
    **{f"noise {s:g} on x alone": noisy(s, "x") for s in (1e-3, 1e-2)},
    **{f"noise {s:g} on e alone": noisy(s, "e") for s in (1e-3, 1e-2, 5e-2)},
    **{f"noise {s:g} on u": noisy(s, "u") for s in (1e-3, 1e-2, 1e-1)},
    **{f"all {b} bits": rounded(2.0 ** (1 - b), *ALL) for b in (16, 12, 10, 8, 6)},
    "u 6 bits": rounded(2.0**-5, "u"),
    **{f"all {d} decimals": rounded(10.0**-d, *ALL) for d in (5, 4, 3)},
    "0.1 % of x lost": lost(0.001, "x"),
    "0.1 % of e lost": lost(0.001, "e"),
    "0.1 % of e, u, x lost": lost(0.001, "e", "u", "x"),
    "0.1 % of e, u, x interpolated": lost(0.001, "e", "u", "x", how="linear"),
    "3 spikes of .2 on x": spiked(0.2, "x"),
    "3 spikes of 5 on u": spiked(5.0, "u"),
    "1 row dropped": rows_dropped(1),
    "5 rows dropped": rows_dropped(5),
    "u includes fd": _includes_fd,
    **{f"u times {f:g}": times(f, "u") for f in (1.1, 1.2, 2, 100, -1)},
    "u in rad": times(np.pi / 180, "u"),
    "u, fd in rad": together(times(np.pi / 180, "u"), times(np.pi / 180, "fd")),
    "e, x, ft in rad": together(*(times(np.pi / 180, n) for n in ("e", "x", "ft"))),
    "x in rad": times(np.pi / 180, "x"),
    "x times 2": times(2, "x"),
    "x times -1": times(-1, "x"),
    "e times 2": times(2, "e"),
    "e, ft times 2": together(times(2, "e"), times(2, "ft")),
    **{f"fd times {f:g}": times(f, "fd") for f in (0.5, 2, -1)},
    "ft times 0.5": times(0.5, "ft"),
    "fd times 1.1": times(1.1, "fd"),
    "a run copied": _copied,
    **{
        f"gap of {s:g} s, {how}": gap(s, how, "e", "u", "x")
        for s in (0.2, 1.0, 4.0)
        for how in ("zero", "last", "linear")
    },
    **{f"gap of u of {s:g} s": gap(s, "zero", "u") for s in (0.5, 2.0, 8.0)},
    **{f"{n} rows dropped": rows_dropped(n) for n in (20, 80)},
    "all zero-phase 3 Hz, 4 decimals": together(filtered(4, 3, *ALL), rounded(1e-4, *ALL)),
    "u zero-phase 3 Hz, 4 decimals": together(filtered(4, 3, "u"), rounded(1e-4, *ALL)),
    "u late 20 ms, noise 1e-3": together(late(0.02, "u"), noisy(1e-3, "x", made=True)),
}


@dataclass(frozen=True)
class Row:
    """One faulty recording; z is empty where nothing was fitted or converged."""

    codes: dict[str, float]
    said: tuple[str, ...]
    z: FloatArray
    covered: FloatArray

    @property
    def off(self) -> bool:
        """Whether a parameter is off by more than three claimed errors."""
        return bool(np.any(np.abs(self.z) > 3.0))


def row_of(fault: str, scenario_name: str, seed: int, number: int, method: str) -> Row | None:
    drawn = scenario_named(scenario_name).drawn(start_rng(seed, scenario_name, number))
    rng = recording_rng(seed, scenario_name, number)
    try:
        recording = FAULTS[fault](simulate(drawn, rng), rng)
    except TypeError:  # a signal that it does not have
        return None
    except InputError:
        return Row({}, ("refused",), np.zeros(0), np.zeros(0))
    codes = {f"{f.signal}:{f.code}": f.size for f in findings(recording)}
    told_of = (*remarks(recording), *map(remark_of, chosen_element(recording).remarks))
    said = [r.code for r in told_of if r.grade != "note"]
    z, covered = np.zeros(0), np.zeros(0)
    if method:
        numbers = fit_rng(seed, method, scenario_name, number)
        estimate = identify(method_named(method), recording, drawn.model, numbers)
        said += [r.code for r in map(remark_of, estimate.remarks) if r.grade != "note"]
        if estimate.outcome.usable:
            z = (estimate.values - drawn.values) / estimate.std_error
            low, high = estimate.intervals.T
            covered = ((low <= drawn.values) & (drawn.values <= high)).astype(float)
        else:
            said.append(estimate.outcome.slug)
    return Row(codes, tuple(said), z, covered)


def told(fault: str, found: list[Row]) -> tuple[str, bool]:
    """A line of the table, and whether fits are right, or wrong ones named in 95 %."""
    count = len(found)
    off = [r for r in found if r.off]
    z = np.concatenate([np.minimum(np.abs(r.z), 99.0) for r in found])
    line = f"{fault:42s} {count:3d} said {100 * np.mean([bool(r.said) for r in found]):3.0f} %"
    right, silent = True, [r for r in off if not r.said]
    if z.size:
        rms = float(np.sqrt(np.mean(z**2)))
        right = rms <= 1.3 or len(silent) <= 0.05 * count
        covered = np.mean(np.concatenate([r.covered for r in found]))
        line += f" | rms z {rms:5.1f} cover {100 * covered:3.0f} %"
        line += f" off {len(off):3d} silent {len(silent):3d}"
    sizes = {
        code: [r.codes[code] for r in found if code in r.codes] for r in found for code in r.codes
    }
    words = [
        f"{code} {100 * len(s) / count:.0f} % ({np.median(s):.3g})" for code, s in sizes.items()
    ]
    others = Counter(
        code for r in found for code in set(r.said) - {c.split(":")[1] for c in r.codes}
    )
    words += [f"{code} {100 * n / count:.0f} %" for code, n in others.most_common(3)]
    return f"{line} | {', '.join(words[:6])}", right


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="nominal,single")
    parser.add_argument("--recordings", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", default="mle", help="empty for the detectors alone")
    parser.add_argument("--fault", default="", help="part of the names of the faults")
    given = parser.parse_args()
    chosen = [name for name in FAULTS if given.fault in name]
    count, missed = 0, []
    for fault in chosen:
        cases = ((s, n) for s in given.scenario.split(",") for n in range(given.recordings))
        rows = (row_of(fault, s, given.seed, n, given.method) for s, n in cases)
        if found := [row for row in rows if row is not None]:
            line, right = told(fault, found)
            count += 1
            missed += [] if right else [fault]
            print(line, flush=True)
    print(f"{count - len(missed)} of {count} faults right or named; not: {'; '.join(missed)}")


if __name__ == "__main__":
    main()
