"""Faults of recorders put on simulated recordings: what is said of them, and what fits make of it.

    nox -s check -- recorder --scenario nominal,population-usual --recordings 20 --method mle

A row for each fault: codes that the detectors name, their median size, how often anything is
said (by the recording's remarks or the fit's), and of the fits that converged the largest median
error over the claimed one of any parameter, the root mean square, and coverage.  `sound` is the
recording without a fault: what is said there is a false alarm.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, lfilter, sosfilt, sosfilt_zi, sosfiltfilt

from pilotid.datasets import scenario_named, simulate
from pilotid.estimates.method import identify
from pilotid.methods import method_named
from pilotid.recordings.checks import remarks
from pilotid.recordings.detectors import findings
from pilotid.recordings.recording import Recording
from pilotid.seeds import fit_rng, recording_rng, start_rng
from pilotid.types import FloatArray

Fault = Callable[[Recording, np.random.Generator], Recording]
ALL = ("e", "u", "x", "ft", "fd")


def each(names: tuple[str, ...], change: Callable[[FloatArray, Recording], FloatArray]) -> Fault:
    """A fault that changes some signals alike."""

    def fault(recording: Recording, _: np.random.Generator) -> Recording:
        there = {n: getattr(recording, n) for n in names}
        changed = {n: change(s, recording) for n, s in there.items() if s is not None}
        return replace(recording, **changed)

    return fault


def late(seconds: float, *names: str) -> Fault:
    """Signals so much late, between the samples by interpolation of the spectrum."""

    def change(signal: FloatArray, recording: Recording) -> FloatArray:
        odd = np.concatenate([signal, 2 * signal[:, -1:] - signal[:, ::-1]], axis=1)
        trend = np.linspace(0.0, 1.0, odd.shape[1]) * (odd[:, -1:] - odd[:, :1])
        omega = 2.0 * np.pi * np.fft.rfftfreq(odd.shape[1], recording.dt)
        moved = np.fft.irfft(np.fft.rfft(odd - trend) * np.exp(-1j * omega * seconds), odd.shape[1])
        slope = trend[:, 1:2] / recording.dt
        return (moved + trend - slope * seconds)[:, : signal.shape[1]]

    return each(names, change)


def samples_late(count: int, *names: str) -> Fault:
    return each(names, lambda s, _: np.concatenate([s[:, :1]] * count + [s[:, :-count]], axis=1))


def filtered(order: int, hertz: float, *names: str, causal: bool = False) -> Fault:
    def change(signal: FloatArray, recording: Recording) -> FloatArray:
        sections = butter(order, hertz, fs=1.0 / recording.dt, output="sos")
        if not causal:
            return np.asarray(sosfiltfilt(sections, signal, axis=1))
        start = sosfilt_zi(sections)[:, None] * signal[None, :, :1]
        return np.asarray(sosfilt(sections, signal, axis=1, zi=start)[0])

    return each(names, change)


def averaged(count: int, *names: str, causal: bool = False) -> Fault:
    def change(signal: FloatArray, _: Recording) -> FloatArray:
        padded = np.pad(signal, ((0, 0), (count, count)), mode="edge")
        found = lfilter(np.ones(count) / count, 1.0, padded, axis=1)
        ahead = 0 if causal else count // 2
        return np.asarray(found[:, count + ahead : count + ahead + signal.shape[1]])

    return each(names, change)


def resampled(count: int, how: str, *names: str) -> Fault:
    def change(signal: FloatArray, _: Recording) -> FloatArray:
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

    def fault(recording: Recording, rng: np.random.Generator) -> Recording:
        changed = {}
        for name in names:
            signal = getattr(recording, name)
            changed[name] = signal + share * np.std(signal) * rng.standard_normal(signal.shape)
        found = replace(recording, **changed)
        return replace(found, e=target(recording) - found.x) if made else found

    return fault


def target(recording: Recording) -> FloatArray:
    return recording.e + recording.x if recording.ft is None else recording.ft


def rounded(size: float, *names: str, of: str = "peak") -> Fault:
    """Steps of a share of the signal's peak, or of the unit."""

    def change(signal: FloatArray, _: Recording) -> FloatArray:
        step = size * (float(np.abs(signal).max()) if of == "peak" else 1.0)
        return np.asarray(step * np.round(signal / (step or 1.0)))

    return each(names, change)


def lost(share: float, *names: str, how: str = "previous") -> Fault:
    """Samples, the same of all signals, replaced by the one before or by interpolation."""

    def fault(recording: Recording, rng: np.random.Generator) -> Recording:
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
    def fault(recording: Recording, rng: np.random.Generator) -> Recording:
        changed = {}
        for name in names:
            signal = getattr(recording, name).copy()
            at = rng.integers(recording.run_in, signal.shape[1], 3)
            signal[:, at] += size * np.std(signal) * rng.choice([-1.0, 1.0], 3)
            changed[name] = signal
        return replace(recording, **changed)

    return fault


def rows_dropped(count: int) -> Fault:
    """Rows missing from the file, its times made anew."""

    def fault(recording: Recording, rng: np.random.Generator) -> Recording:
        total = recording.u.shape[1]
        gone = rng.choice(np.arange(recording.run_in + 50, total - 50), count, replace=False)
        kept = np.delete(np.arange(total), gone)
        there = {n: getattr(recording, n) for n in ALL}
        return replace(
            recording, **{n: s[:, kept] for n, s in there.items() if s is not None}, lines={}
        )

    return fault


def jitter(share: float) -> Fault:
    """Samples taken at times that scatter by a share of the interval."""

    def fault(recording: Recording, rng: np.random.Generator) -> Recording:
        from scipy.interpolate import CubicSpline

        time = np.arange(recording.u.shape[1], dtype=float)
        at = time + share * rng.standard_normal(time.size)
        there = {n: getattr(recording, n) for n in ALL}
        return replace(
            recording,
            **{n: CubicSpline(time, s, axis=1)(at) for n, s in there.items() if s is not None},
        )

    return fault


def drifting(ppm: float) -> Fault:
    def change(signal: FloatArray, _: Recording) -> FloatArray:
        from scipy.interpolate import CubicSpline

        time = np.arange(signal.shape[1], dtype=float)
        return np.asarray(CubicSpline(time, signal, axis=1)(time * (1.0 + 1e-6 * ppm)))

    return each(("u",), change)


def times(factor: float, name: str) -> Fault:
    return each((name,), lambda s, _: factor * s)


def together(*faults: Fault) -> Fault:
    def fault(recording: Recording, rng: np.random.Generator) -> Recording:
        for one in faults:
            recording = one(recording, rng)
        return recording

    return fault


def _includes_fd(recording: Recording, _: np.random.Generator) -> Recording:
    return recording if recording.fd is None else replace(recording, u=recording.u + recording.fd)


def _made_of_filtered_output(recording: Recording, rng: np.random.Generator) -> Recording:
    x = filtered(2, 5.0, "x", causal=True)(recording, rng).x
    return replace(recording, x=x, e=target(recording) - x)


def _copied(recording: Recording, rng: np.random.Generator) -> Recording:
    rows = {n: np.concatenate([s, s]) for n in ALL if (s := getattr(recording, n)) is not None}
    return noisy(1e-3, "u")(replace(recording, **rows), rng)


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
    "e = ft - filtered x": _made_of_filtered_output,
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
    **{f"jitter {s:g}": jitter(s) for s in (0.01, 0.1, 0.5)},
    **{f"clock of u {p} ppm": drifting(p) for p in (100, 300, 500, 2000)},
    "u includes fd": _includes_fd,
    "u times 1.1": times(1.1, "u"),
    "fd times 1.1": times(1.1, "fd"),
    "a run copied": _copied,
    "all zero-phase 3 Hz, 4 decimals": together(filtered(4, 3, *ALL), rounded(1e-4, *ALL)),
    "u zero-phase 3 Hz, 4 decimals": together(filtered(4, 3, "u"), rounded(1e-4, *ALL)),
    "u late 20 ms, noise 1e-3": together(late(0.02, "u"), noisy(1e-3, "x", made=True)),
}


@dataclass(frozen=True)
class Row:
    """One faulty recording; z is empty where nothing was fitted or converged."""

    fault: str
    codes: tuple[str, ...]
    sizes: tuple[float, ...]
    remarked: bool
    fitted: str
    z: FloatArray
    covered: FloatArray
    keys: tuple[str, ...]
    specification: float


def row_of(fault: str, scenario_name: str, seed: int, number: int, method: str) -> Row | None:
    drawn = scenario_named(scenario_name).drawn(start_rng(seed, scenario_name, number))
    rng = recording_rng(seed, scenario_name, number)
    try:
        recording = FAULTS[fault](simulate(drawn, rng), rng)
    except TypeError:  # a signal that it does not have
        return None
    found = findings(recording)
    told_of = [r for r in remarks(recording) if r.grade != "note"]
    keys = drawn.model.keys
    z, covered, outcome, p = np.zeros(0), np.zeros(0), "", 1.0
    if method:
        estimate = identify(
            method_named(method),
            recording,
            drawn.model,
            fit_rng(seed, method, scenario_name, number),
        )
        outcome = estimate.outcome.slug
        if estimate.specification is not None:
            p = estimate.specification.p_value
        if estimate.outcome.usable:
            z = (estimate.values - drawn.values) / estimate.std_error
            low, high = estimate.intervals.T
            covered = ((low <= drawn.values) & (drawn.values <= high)).astype(float)
    return Row(
        fault,
        tuple(f"{f.signal}:{f.code}" for f in found),
        tuple(f.size for f in found),
        bool(told_of),
        outcome,
        z,
        covered,
        keys,
        p,
    )


def rows(names: list[str], scenarios: list[str], seed: int, n: int, method: str) -> Iterator[Row]:
    for fault in names:
        for scenario in scenarios:
            for number in range(n):
                if (row := row_of(fault, scenario, seed, number, method)) is not None:
                    yield row


def told(fault: str, found: list[Row]) -> str:
    count = len(found)
    codes = Counter(code for row in found for code in set(row.codes))
    words = []
    for code, n in codes.most_common(4):
        known = zip((r.codes for r in found), (r.sizes for r in found), strict=True)
        sizes = [v for own, each in known for c, v in zip(own, each, strict=True) if c == code]
        words.append(f"{code} {100 * n / count:.0f} % ({np.median(sizes):.3g})")
    line = f"{fault:32s} {count:4d} doubt {100 * np.mean([r.remarked for r in found]):3.0f} %"
    fits = [r for r in found if r.z.size]
    if fits:
        by_key: dict[str, list[float]] = {}
        for r in fits:
            for key, z in zip(r.keys, r.z, strict=True):
                by_key.setdefault(key, []).append(z)
        worst = max(by_key, key=lambda k: abs(float(np.median(by_key[k]))))
        z = np.concatenate([r.z for r in fits])
        off = [np.abs(r.z).max() > 4.0 for r in fits]
        said = [r.remarked or r.specification < 0.001 for r in fits]
        silent = np.mean([o and not s for o, s in zip(off, said, strict=True)])
        against = np.mean([r.specification < 0.001 for r in fits])
        line += (
            f" | fits {len(fits):3d} rms z {np.sqrt(np.mean(np.minimum(np.abs(z), 99) ** 2)):5.1f} "
            f"{worst} {np.median(by_key[worst]):+.1f} cover "
            f"{100 * np.mean(np.concatenate([r.covered for r in fits])):3.0f} % "
            f"spec {100 * against:3.0f} % wrong {100 * np.mean(off):3.0f} % "
            f"silent {100 * silent:3.0f} %"
        )
    return f"{line} | {', '.join(words)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="nominal,single")
    parser.add_argument("--recordings", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", default="mle", help="empty for the detectors alone")
    parser.add_argument("--fault", default="", help="part of the names of the faults")
    given = parser.parse_args()
    scenarios = given.scenario.split(",")
    for fault in (name for name in FAULTS if given.fault in name):
        found = list(rows([fault], scenarios, given.seed, given.recordings, given.method))
        if found:
            print(told(fault, found), flush=True)


if __name__ == "__main__":
    main()
