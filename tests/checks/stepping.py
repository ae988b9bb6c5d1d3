"""Recordings from a generator that shares no code with pilotid's: the loop is stepped in time.

Pilots, elements, forcing functions, remnants and recorders are drawn from ranges of their own.
No constant of this project was set on what comes from here.
"""

from __future__ import annotations

import numpy as np

from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray

STEP = 0.001  # s, of Heun's rule
RUN_IN, MEASURED = 8.0, 90.0  # s
TRUTH = ("Kvis", "tlead", "tdvis", "fnm", "dnm")
MARGIN = np.radians(25.0)  # phase margin that every pilot leaves


def _pilot(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """A stable compensatory pilot in front of an element K / (s (s + a)).

    Returns the values of `TRUTH`, shape (5,), and K and a, shape (2,).
    """
    while True:
        break_, gain = rng.uniform(0.0, 6.0), 10.0 ** rng.uniform(-1.0, 1.5)
        lead = rng.uniform(0.6, 1.2) / max(break_, 0.4)
        delay, stiff, damping = (
            rng.uniform(0.15, 0.35),
            rng.uniform(7.0, 14.0),
            rng.uniform(0.15, 0.6),
        )
        s = 1j * np.geomspace(0.05, 60.0, 4000)
        muscle = stiff**2 / (s**2 + 2.0 * damping * stiff * s + stiff**2)
        open_loop = (1.0 + lead * s) * np.exp(-delay * s) * muscle * gain / (s * (s + break_))
        cross = np.argmin(np.abs(s.imag - rng.uniform(1.2, 3.5)))
        size = 1.0 / abs(open_loop[cross])
        loop = size * open_loop
        # Below 1 wherever the phase is beyond -180 degrees: stable with a margin in gain as well.
        phase = np.unwrap(np.angle(loop))
        beyond = phase < -np.pi
        if phase[cross] > MARGIN - np.pi and np.max(np.abs(loop[beyond]), initial=0.0) < 0.7:
            return np.array([size, lead, delay, stiff, damping]), np.array([gain, break_])


def _sines(
    rng: np.random.Generator, time: FloatArray, low: float, high: float, odd: int
) -> FloatArray:
    """A sum of sines at even or odd multiples of 2 pi / `MEASURED`, root mean square 1."""
    base = 2.0 * np.pi / MEASURED
    omega = (2 * np.unique(np.geomspace(low, high, 9) // (2.0 * base)) + odd) * base
    size = 1.0 / (1.0 + (omega / rng.uniform(0.8, 2.5)) ** 2)
    phase = rng.uniform(0.0, 2.0 * np.pi, omega.size)
    signal = (size[:, None] * np.sin(omega[:, None] * time + phase[:, None])).sum(axis=0)
    return np.asarray(signal / np.sqrt(0.5 * np.sum(size**2)))


def stepped(rng: np.random.Generator, count: int) -> list[tuple[FloatArray, Recording]]:
    """Truth, in the order of `TRUTH`, and recording of so many pilots."""
    drawn = [_pilot(rng) for _ in range(count)]
    truth, plants = (np.array(part).T for part in zip(*drawn, strict=True))
    gain, lead, delay, stiff, damping = truth
    strength, break_ = plants
    time = np.arange(0.0, RUN_IN + MEASURED, STEP)
    target = np.array([_sines(rng, time, 0.3, 16.0, 0) for _ in range(count)]).T
    ratio = rng.uniform(0.2, 0.8, count) / 3.0
    disturbance = np.array([_sines(rng, time, 0.35, 19.0, 1) for _ in range(count)]).T
    disturbance *= ratio * rng.uniform(2.0, 6.0, count) / strength
    # The remnant: white noise behind one to three lags, added to the pilot's output.
    lag = 1.0 / rng.uniform(4.0, 16.0, count)
    order = rng.integers(1, 4, count)
    noise = rng.standard_normal((time.size, count))
    for stage in range(3):
        keep = np.where(stage < order, np.exp(-STEP / lag), 0.0)
        held = np.zeros(count)
        for row in noise:
            held[:] = keep * held + (1.0 - keep) * row
            row[:] = held
    noise /= noise.std(axis=0)

    place = np.round(delay / STEP).astype(int)
    truth = truth.copy()
    truth[2] = place * STEP
    every = np.arange(count)
    remnant_size = np.zeros(count)

    def change(state: FloatArray, heard: FloatArray, force: FloatArray) -> FloatArray:
        out, rate, _, speed = state
        pull = stiff**2 * gain * heard
        return np.array(
            [
                rate + lead * pull - 2.0 * damping * stiff * out,
                pull - stiff**2 * out,
                speed,
                strength * (out + force) - break_ * speed,
            ]
        )

    for share in (0.0, 1.0):  # without a remnant first, to know the control's size
        state = np.zeros((4, count))
        error, control, output = (np.zeros_like(target) for _ in range(3))
        fade = np.minimum(1.0, time / 4.0)
        for k in range(time.size):
            error[k] = fade[k] * target[k] - state[2]
            control[k] = state[0] + remnant_size * noise[k]
            output[k] = state[2]
            if k + 1 == time.size:
                break
            heard = np.where(k >= place, error[np.maximum(k - place, 0), every], 0.0)
            after = np.where(k + 1 >= place, error[np.maximum(k + 1 - place, 0), every], 0.0)
            force = fade[k : k + 2, None] * disturbance[k : k + 2] + remnant_size * noise[k : k + 2]
            slope = change(state, heard, force[0])
            state = state + 0.5 * STEP * (slope + change(state + STEP * slope, after, force[1]))
        if not share:
            remnant_size = np.sqrt(rng.uniform(0.05, 0.35, count)) * control.std(axis=0)

    found = []
    for i in range(count):
        every_nth = int(rng.choice([5, 10, 20]))
        signals = {"e": error, "u": control, "x": output, "ft": target, "fd": disturbance}
        rows = {name: signal[::every_nth, i][None] for name, signal in signals.items()}
        recording = Recording(
            dt=every_nth * STEP, **rows, run_in=round(RUN_IN / STEP / every_nth), source="stepped"
        )
        found.append((truth[:, i], recording))
    return found
