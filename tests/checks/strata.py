"""Recordings of strata from a generator that shares no code with pilotid's.

Pilots, elements, forcing functions, remnants and recorders have formulas and ranges of their own;
loops are solved in frequency, from a minute before the run-in on.  A pilot leaves a modulus margin
of .45.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pilotid.model.catalogue import MODELS
from pilotid.model.model import PilotModel
from pilotid.recording.recording import ABSENT, Recording
from pilotid.support.types import ComplexArray, FloatArray

Generator, Values = np.random.Generator, dict[str, float]
USUAL = ("single", "multi", "rate", "lead-lag")
#: The models of each stratum.
STRATA = {
    "textbook": (*USUAL, "gain"),
    "other-models": (
        *("pursuit", "look-ahead", "lead2-lag", "precision", "lead-lag-motion"),
        *("lead2-lag-motion", "following", "lead-lag-canals"),
    ),
    **dict.fromkeys(("hard-remnants", "recorders", "late", "short", "odd-forcing", "steps"), USUAL),
}
REMNANTS = ("student", "bursts", "narrow", "pink", "two", "envelope")
RECORDERS = ("rounded", "noise", "held", "no fd", "no ft", "neither", "offset", "decimals")
FORCING = ("few", "aperiodic", "filtered", "steps", "ramps", "target", "disturbance")
#: Keys of motion channels, and seconds before the run-in and behind the recording.
MOTION, BEFORE, BEHIND = ("Kvest", "Km"), 60.0, 20.0


def channels(name: str, s: ComplexArray, p: Values) -> list[tuple[str, ComplexArray]]:
    """What each channel of a model acts on, and its signed response."""
    muscle = p["fnm"] ** 2 / (s * s + 2.0 * p["dnm"] * p["fnm"] * s + p["fnm"] ** 2)
    if name == "following":
        return [("ft", p["Kt"] / (1.0 + p["tlagt"] * s) * np.exp(-p["tdt"] * s) * muscle)]
    visual = p["Kvis"] / (1.0 + p.get("tlag", 0.0) * s) * np.exp(-p["tdvis"] * s) * muscle
    if name == "look-ahead":
        return [("ft", p["Kt"] * np.exp(p["tlook"] * s) * muscle), ("x", -visual)]
    visual = visual * (1.0 + p.get("tlead", 0.0) * s) ** (2 if name.startswith("lead2") else 1)
    visual = visual * (1.0 + p.get("tleadlow", 0.0) * s) / (1.0 + p.get("tlaglow", 0.0) * s)
    answers = [("e", visual)]
    if "Km" in p:
        answers.append(("x", -s * p["Km"] * np.exp(-p["tdm"] * s) * muscle))
    if "Kvest" in p:
        canals = s * s * (1.0 + 0.1 * s) / (1.0 + 6.0 * s)
        answers.append(("x", -canals * p["Kvest"] * np.exp(-p["tdvest"] * s) * muscle))
    if name == "pursuit":
        rate = s * p["Kt"] / (1.0 + p["tlagt"] * s)
        answers.append(("ft", rate * np.exp(-p["tdt"] * s) * muscle))
    return answers


def pilot(name: str, rng: Generator) -> tuple[float | None, float, Values]:
    """A stable pilot: pole b and gain K of his element K/(s(s+b)), or K/s, and his values."""
    ranges = {
        **{"Kvis": (1.0, 1.0), "tlead": (0.6, 1.3), "tlag": (0.1, 0.8), "tdvis": (0.14, 0.36)},
        **{"Kvest": (1.0, 1.0), "tdvest": (0.1, 0.3), "Km": (1.0, 1.0), "tdm": (0.1, 0.3)},
        **{"tleadlow": (2.0, 4.0), "tlaglow": (6.0, 15.0), "tlook": (0.2, 0.9)},
        **{"Kt": (0.7, 1.1), "tlagt": (0.1, 0.5), "tdt": (0.1, 0.3)},
        **{"fnm": (7.0, 15.0), "dnm": (0.15, 0.6)},
    }
    s = 1j * np.geomspace(0.02, 200.0, 6000)
    while True:
        p = {key: float(rng.uniform(*ranges[key])) for key in MODELS[name].keys}
        if name == "following":
            return None, 0.0, p
        poles = (None, 0.0, rng.uniform(0.3, 4.0), rng.uniform(4.0, 9.0))
        pole = poles[rng.integers(2 if {*MOTION} & {*p} else 0, 4)]
        if name in ("gain", "look-ahead") or name.startswith("lead2"):
            pole = 0.0 if name.startswith("lead2") else None
        if "tlead" in p:
            p["tlead"] *= 0.3 if pole is None else 0.6 if name.startswith("lead2") else 1.0
            p["tlead"] /= 1.0 if pole is None or name.startswith("lead2") else max(pole, 0.5)
        gain = float(np.exp(rng.uniform(np.log(0.2), np.log(20.0))))
        plant = gain / s if pole is None else gain / (s * (s + pole))
        parts = [r if on == "e" else -r for on, r in channels(name, s, p) if on != "ft"]
        crossover = int(np.argmin(np.abs(s.imag - rng.uniform(1.0, 3.5))))
        p["Kvis"] = float(1.0 / abs((plant * parts[0])[crossover]))
        loop = plant * parts[0] * p["Kvis"]
        for key, part in zip([key for key in MOTION if key in p], parts[1:], strict=True):
            p[key] = float(rng.uniform(0.25, 0.9) / abs((plant * part)[crossover]))
            loop = loop + plant * part * p[key]
        if "Kt" in p:
            p["Kt"] *= p["Kvis"] if name == "look-ahead" else 0.4 / (gain / max(pole or 1.0, 1.0))
        turn = np.unwrap(np.angle(1.0 + loop[::-1]))[-1] / (-0.5 * np.pi)
        if abs(turn - (2.0 if pole == 0.0 else 1.0)) < 0.7 and np.min(np.abs(1.0 + loop)) > 0.45:
            return pole, gain, p


def remnant(kind: str, rng: Generator, shape: tuple[int, int], dt: float) -> FloatArray:
    """A remnant of variance 1, a low-pass one of order 1 to 3 unless said."""
    omega = 2.0 * np.pi * np.fft.rfftfreq(shape[1], dt)
    s, white = 1j * omega, rng.standard_normal(shape)
    if kind == "student":
        white = rng.standard_t(3.0, shape)
    if kind == "bursts":
        begins = (rng.random(shape[1]) < 0.4 * dt).astype(float)
        white *= 0.4 + 4.0 * (np.convolve(begins, np.ones(int(0.4 / dt)), "same") > 0.0)
    low = 1.0 / (1.0 + s / rng.uniform(2.0, 15.0)) ** int(rng.integers(1, 4))
    if kind == "narrow":
        peak = rng.uniform(2.0, 9.0)
        low = peak**2 / (s * s + 2.0 * rng.uniform(0.06, 0.25) * peak * s + peak**2) + 0.3 * low
    if kind == "pink":
        low = (omega**2 + 0.04) ** (-0.5 * rng.uniform(0.6, 1.6))
    if kind == "two":
        low = low + 0.3 / (1.0 + s / rng.uniform(15.0, 60.0))
    values = np.fft.irfft(np.fft.rfft(white) * low, shape[1])
    if kind == "envelope":
        slow = np.fft.irfft(np.fft.rfft(rng.standard_normal(shape)) / (1.0 + 2.0 * s), shape[1])
        values *= np.exp(0.6 * slow / slow.std())
    values -= values.mean(axis=1, keepdims=True)
    return np.asarray(values / values.std())


def forcing(kind: str, rng: Generator, time: FloatArray, seconds: float) -> list[FloatArray]:
    """Target and disturbance of standard deviation 1, or zero."""
    dt, count = float(time[1] - time[0]), time.size
    base, top = 2.0 * np.pi / seconds, int(rng.uniform(14.0, 20.0) * seconds / (2.0 * np.pi))
    lines = np.unique(np.geomspace(rng.uniform(2.0, 5.0), top, 10).astype(int))

    def sines(omega: FloatArray) -> FloatArray:
        size = 1.0 / (1.0 + (omega / rng.uniform(0.8, 3.0)) ** rng.uniform(1.0, 2.0))
        phases = rng.uniform(0.0, 2.0 * np.pi, omega.size)
        return np.asarray(size @ np.sin(np.outer(omega, time) + phases[:, None]))

    def once() -> FloatArray:
        if kind == "filtered":
            s = 2j * np.pi * np.fft.rfftfreq(count, dt)
            return np.fft.irfft(
                np.fft.rfft(rng.standard_normal(count)) / (1.0 + s / 2.0) ** 2, count
            )
        knots = (
            np.cumsum(rng.standard_normal(count)) if kind == "ramps" else rng.standard_normal(count)
        )
        places = np.arange(count) / round(4.0 / dt)
        return np.interp(places if kind == "ramps" else places // 1, np.arange(count), knots)

    if kind == "few":
        both = [sines(base * np.array([3, 7, 17, 37])), sines(base * np.array([5, 11, 23, 53]))]
    elif kind == "aperiodic":
        both = [sines(base * lines * rng.uniform(0.9, 1.1, lines.size)) for _ in range(2)]
    elif kind in ("filtered", "steps", "ramps"):
        both = [once(), once()]
    else:
        both = [sines(base * lines), sines(base * np.setdiff1d(lines + 1 + lines % 2, lines))]
    fade = np.clip((time - time[0] - 5.0) / 10.0, 0.0, 1.0) * np.clip(
        (time[-1] - time) / 5.0, 0.0, 1.0
    )
    kept = {"target": (1.0, 0.0), "disturbance": (0.0, 1.0)}.get(kind, (1.0, 1.0))
    return [share * fade * signal / signal.std() for share, signal in zip(kept, both, strict=True)]


def recorded(kind: str, rng: Generator, dt: float, signals: dict[str, FloatArray]) -> None:
    """What a recorder does to signals, in place."""
    for name in ("e", "u", "x"):
        signal, step = (
            signals[name],
            float(np.ptp(signals[name])) * 2.0 ** -int(rng.integers(7, 11)),
        )
        if kind == "rounded":
            signals[name] = np.round(signal / step) * step
        if kind == "decimals":
            signals[name] = np.round(signal, 3)
        if kind == "noise" and name != "u":
            signals[name] = signal + 0.003 * signal.std() * rng.standard_normal(signal.shape)
    if kind == "held":
        for name, signal in signals.items():
            signals[name] = np.repeat(signal[:, ::2], 2, axis=1)[:, : signal.shape[1]]
    if kind == "offset":
        signals["u"] = signals["u"] + rng.uniform(-2.0, 2.0) * signals["u"].std()
    for name in {"no fd": ("fd",), "no ft": ("ft",), "neither": ("ft", "fd")}.get(kind, ()):
        del signals[name]
    if kind in ("u", "x"):  # late
        late = max(1, round(0.02 * int(rng.integers(1, 4)) / dt))
        signals[kind] = np.concatenate(
            [signals[kind][:, :1]] * late + [signals[kind][:, :-late]], 1
        )


def of_stratum(stratum: str, number: int) -> tuple[Recording, PilotModel, Values]:
    """A recording of a stratum by its number, with its model and truth."""
    rng = np.random.default_rng([404, number, *stratum.encode()])
    names = STRATA[stratum]
    name = names[(number + number // 12) % len(names)]
    pole, gain, values = pilot(name, rng)
    chosen = {
        "hard-remnants": REMNANTS,
        "recorders": RECORDERS,
        "odd-forcing": FORCING,
        "late": "ux",
        "steps": ("steps",),
    }
    kind = chosen[stratum][number % len(chosen[stratum])] if stratum in chosen else ""
    dt = float(rng.choice([0.005, 0.01, 0.02, 0.04]))
    seconds = float(rng.choice([60.0, 90.0, 120.0]))
    runs, run_in = int(rng.choice([1, 1, 2, 3, 5])), float(rng.choice([4.0, 6.0, 8.0, 10.0]))
    if stratum == "short":
        runs, run_in, seconds = 1, float(rng.choice([0.0, 3.0])), round(rng.uniform(22.0, 40.0))
    fine = 8 if stratum == "steps" else 1  # samples for one, as a target jumps at one
    dt /= fine
    before, lead, samples = (fine * round(t / dt / fine) for t in (BEFORE, run_in, seconds))
    count = 2 * ((before + lead + samples + round(BEHIND / dt)) // 2)
    time = (np.arange(count) - before - lead) * dt
    target, disturbance = forcing(kind, rng, time, seconds)
    target *= float(np.exp(rng.uniform(-1.0, 1.6)))
    s = 2j * np.pi * np.fft.rfftfreq(count, dt)
    s[0] = 1e-4 * s[1]  # an integrator has no response at rest
    plant = 0.0 * s if name == "following" else gain / (s if pole is None else s * (s + pole))
    on = dict.fromkeys(("e", "x", "ft"), 0.0 * s)
    for key, answer in channels(name, s, values):
        on[key] = on[key] + answer

    def closed(ft: Any, fd: Any, noise: Any) -> FloatArray:
        around = plant * (on["e"] - on["x"])
        control = ((on["e"] + on["ft"]) * ft - around * fd + noise) / (1.0 + around)
        both = np.fft.irfft([control, plant * (control + fd)], count)[:, before:]
        return np.asarray(both[:, : lead + samples])

    by_target = closed(np.fft.rfft(target), 0.0, 0.0)[0].std()
    by_disturbance = closed(0.0, np.fft.rfft(disturbance), 0.0)[0].std()
    if by_target > 0.0 < by_disturbance:
        disturbance *= rng.uniform(0.4, 1.2) * by_target / by_disturbance
    given = np.fft.rfft(target), np.fft.rfft(disturbance)
    noises = remnant(kind, rng, (runs, count), dt)
    share, forced = rng.uniform(0.08, 0.35), closed(*given, 0.0)[0].std()
    left = np.std([closed(0.0, 0.0, np.fft.rfft(noise))[0] for noise in noises])
    noises *= forced / left * np.sqrt(share / (1.0 - share))
    both = np.array([closed(*given, np.fft.rfft(noise)) for noise in noises])[..., ::fine]
    window = slice(before, before + lead + samples, fine)
    signals = {
        name: np.tile(f[window], (runs, 1)) for name, f in (("ft", target), ("fd", disturbance))
    }
    signals |= {"u": both[:, 0], "x": both[:, 1], "e": signals["ft"] - both[:, 1]}
    recorded(kind, rng, dt, signals)
    more: dict[str, Any] = {"origin": {"x": ABSENT}} if name == "following" else {}
    if name != "following" and rng.random() < 0.3:
        more["controlled_element"] = f"{gain!r}/s" if pole is None else f"{gain!r}/(s*(s+{pole!r}))"
    kept = {key: v for key, v in signals.items() if key in ("e", "u", "x") or np.any(v)}
    return Recording(dt=fine * dt, run_in=lead // fine, **kept, **more), MODELS[name], values
