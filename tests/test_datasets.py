"""Simulated data sets: forcing functions, remnant, scenarios, and an independent simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, without_remnant
from scipy.signal import cont2discrete, lfilter

from pilotid.checks.element_fit import identified_element
from pilotid.datasets import SCENARIOS, Scenario, scenario_named, simulate
from pilotid.datasets.population import POPULATIONS
from pilotid.datasets.recorder import Recorder
from pilotid.datasets.signals import (
    UNIT_LEVEL,
    Forcing,
    Multisine,
    Remnant,
    Steps,
    anti_aliasing,
    half_and_half_step,
    paper_disturbance,
    paper_target,
    white,
)
from pilotid.datasets.simulation import remnant_ratio, white_level
from pilotid.model.element import element_named
from pilotid.recording.recording import Recording
from pilotid.support.types import ComplexArray, FloatArray, InputError

pytestmark = pytest.mark.numerical

DT = 0.02
SAMPLES = 4096
WINDOW = np.arange(SAMPLES) * DT

#: Table 2 of AIAA 2008-7109.
FD_LINES = (5, 8, 11, 17, 28, 46, 59, 82, 106, 137, 178, 211)
FT_LINES = (6, 9, 13, 19, 29, 47, 61, 83, 107, 139, 179, 213)
FD_AMPLITUDES = "0031 0071 0115 0193 0284 0363 0407 0488 059 0755 1033 1308"
FT_AMPLITUDES = "0876 0764 0613 043 025 012 0081 0052 0038 0029 0024 0021"


def with_remnant(scenario: Scenario, **changes: object) -> Scenario:
    return replace(scenario, remnant=replace(scenario.remnant, **changes))


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


# ------------------------------------------------------------------ forcing functions


@pytest.mark.parametrize(
    ("forcing", "lines", "amplitudes"),
    [(paper_disturbance(), FD_LINES, FD_AMPLITUDES), (paper_target(), FT_LINES, FT_AMPLITUDES)],
    ids=["disturbance", "target"],
)
def test_the_paper_s_forcing_functions_are_those_of_table_2(
    forcing: Multisine, lines: tuple[int, ...], amplitudes: str
) -> None:
    assert forcing.lines == lines
    assert forcing.amplitudes == tuple(float(f"0.{a}") for a in amplitudes.split())
    assert forcing.phases == (0.0,) * 12
    assert forcing.period == 81.92


def test_random_phases_keep_the_amplitude_spectrum() -> None:
    forcing = paper_target()
    variants = [forcing.with_random_phases(rng(seed)) for seed in (1, 1, 2)]
    spectra = [np.fft.rfft(f.at(WINDOW)) * 2.0 / SAMPLES for f in (forcing, *variants)]
    expected = np.zeros(SAMPLES // 2 + 1)
    expected[list(FT_LINES)] = forcing.amplitudes
    for spectrum in spectra:
        np.testing.assert_allclose(np.abs(spectrum), expected, atol=1e-12)
    np.testing.assert_array_equal(spectra[1], spectra[2])
    turned = np.angle(spectra[3][list(FT_LINES)] / spectra[1][list(FT_LINES)])
    assert np.all(np.abs(turned) > 1e-3)


def sharp(step: Steps, time: FloatArray) -> FloatArray:
    """The steps without an anti-aliasing filter."""
    # Half a nanosecond guards against a sample time that rounding put before its jump.
    return (time[:, None] >= np.array(step.times) - 5e-10) @ np.array(step.jumps)


def test_recorded_step_is_the_sharp_one_but_for_the_samples_beside_a_jump() -> None:
    step = half_and_half_step(81.92)
    time = np.arange(-400, SAMPLES) * DT
    away = np.min(np.abs(time[:, None] - np.array(step.times)), axis=1) > 0.2
    np.testing.assert_allclose(step.at(time)[away], sharp(step, time)[away], atol=2e-3)
    # Halfway up at the jump itself: the filter has no phase.
    assert step.at(time)[400] == pytest.approx(0.5, abs=0.01)
    spectrum = np.abs(np.fft.rfft(np.diff(step.at(time)[:2000])))
    assert spectrum[-1] < 1e-3 * spectrum.max()


def lagged(omega: FloatArray) -> ComplexArray:
    """3 e^{-0.137 s}/(1 + 0.5 s), whose delay is no multiple of the sampling interval."""
    return np.asarray(3.0 * np.exp(-0.137j * omega) / (1.0 + 0.5j * omega))


def test_multisine_through_a_system_equals_the_sum_of_its_lines() -> None:
    forcing = paper_disturbance().with_random_phases(rng(3))
    time = np.array([-7.5, -0.01, 0.0, 3.3, 81.0])
    expected = np.zeros(time.size)
    for line, amplitude, phase in zip(
        forcing.lines, forcing.amplitudes, forcing.phases, strict=True
    ):
        w = 2.0 * math.pi * line / 81.92
        gain, lag = 3.0 / math.hypot(1.0, 0.5 * w), 0.137 * w + math.atan(0.5 * w)
        expected += gain * amplitude * np.sin(w * time + phase - lag)
    np.testing.assert_allclose(forcing.through(lagged, time), expected, atol=1e-11)


def test_steps_through_a_system_equal_the_analytic_answer() -> None:
    time = np.arange(-100, 1500) * DT
    steps = Steps((0.0, 15.0), (1.0, -0.4))
    since = time[:, None] - 0.137 - np.array(steps.times)
    answers = 3.0 * (1.0 - np.exp(-np.maximum(since, 0.0) / 0.5)) @ np.array(steps.jumps)
    away = np.min(np.abs(since), axis=1) > 0.2  # of the bends, which the recorder rounds off
    np.testing.assert_allclose(steps.through(lagged, time)[away], answers[away], atol=3e-4)


# ------------------------------------------------------------------ remnant


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_remnant_filter_at_rest_at_its_break_frequency_and_far_above(order: int) -> None:
    remnant = Remnant(order=order, frequency=3.5, damping=0.7)
    at_rest, at_break, far = remnant.filter(np.array([0.0, 3.5, 3500.0]))
    assert at_rest == pytest.approx(1.0, rel=1e-12)
    # First order: 3 dB and 45 deg; second order: 1/(2 z) and 90 deg; third: their product.
    magnitude = (1.0, 1.0 / math.sqrt(2.0), 1.0 / 1.4, 1.0 / (1.4 * math.sqrt(2.0)))[order]
    assert abs(at_break) == pytest.approx(magnitude, rel=1e-12)
    assert np.angle(at_break, deg=True) == pytest.approx(-45.0 * order, abs=1e-9)
    assert abs(far) == pytest.approx(1000.0**-order, rel=1e-5)


@pytest.mark.parametrize(
    ("gain", "ratio", "tolerance"), [(0.1, 0.03, 0.002), (0.4, 0.21, 0.01), (0.8, 0.305, 0.015)]
)
def test_remnant_gain_has_the_paper_s_scale(gain: float, ratio: float, tolerance: float) -> None:
    assert remnant_ratio(SCENARIOS[f"remnant-{gain}"]) == pytest.approx(ratio, abs=tolerance)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("level", [0.05, 0.2, 0.3])
def test_ratio_level_hits_its_ratio(order: int, level: float) -> None:
    scenario = replace(NOMINAL, remnant=Remnant(order=order, level=level, level_is="ratio"))
    assert remnant_ratio(scenario) == pytest.approx(level, rel=1e-9)


def test_unreachable_ratio_is_refused_with_the_limit() -> None:
    scenario = replace(NOMINAL, remnant=white(0.95))
    with pytest.raises(InputError, match=r"^scenario nominal: .*0\.95.*limits it to 0\.\d+$"):
        simulate(scenario, rng())


def spread(samples: FloatArray) -> float:
    return float(np.std(samples, ddof=1) / math.sqrt(samples.size))


@pytest.mark.parametrize(
    "scenario",
    [
        NOMINAL,
        SCENARIOS["white-remnant"],
        SCENARIOS["disturbance-step"],
        with_remnant(NOMINAL, order=3, frequency=6.0),
        with_remnant(NOMINAL, order=1, level=0.2, level_is="ratio"),
        with_remnant(NOMINAL, enters="neuromuscular"),
    ],
    ids=lambda s: f"{s.name} {s.remnant.order} {s.remnant.enters} {s.remnant.level_is}",
)
def test_measured_remnant_power_agrees_with_remnant_ratio(scenario: Scenario) -> None:
    # With hardly any controlled element the loop is open, and u is the remnant itself.
    level = white_level(scenario) / UNIT_LEVEL
    runs = 120
    alone = replace(
        with_remnant(scenario, level=level, level_is="gain"),
        element=element_named("1e-12"),
        target=None,
        disturbance=None,
        runs=runs,
    )
    n = simulate(alone, rng(11))
    u = simulate(replace(scenario, runs=runs), rng(12))
    power_n, power_u = (np.var(r.window(r.u), axis=1) for r in (n, u))
    measured = power_n.mean() / power_u.mean()
    error = measured * math.hypot(
        spread(power_n) / power_n.mean(), spread(power_u) / power_u.mean()
    )
    assert error < 0.03 * measured
    assert abs(measured - remnant_ratio(scenario)) < 4.0 * error


# ------------------------------------------------------------------ scenarios and recordings


def test_scenarios_have_the_names_of_the_contract() -> None:
    names = "nominal single white-remnant disturbance-only target-only disturbance-step target-step"
    assert set(names.split()) | {f"remnant-0.{g}" for g in range(1, 9)} <= set(SCENARIOS)
    assert all(SCENARIOS[name].name == name for name in SCENARIOS)
    assert scenario_named("single") is SCENARIOS["single"]


def test_nominal_and_single_scenarios_are_those_of_the_paper() -> None:
    for scenario in (SCENARIOS["nominal"], SCENARIOS["single"]):
        assert scenario.element == element_named("4/s^2")
        assert (scenario.target, scenario.disturbance) == (paper_target(), paper_disturbance())
        assert (scenario.remnant.level, scenario.remnant.order) == (0.4, 2)
    assert NOMINAL.truth == (0.17, 2.93, 0.32, 1.59, 0.29, 12.0, 0.3)
    assert SCENARIOS["single"].truth == (0.32, 1.68, 0.39, 12.0, 0.3)
    assert SCENARIOS["white-remnant"].remnant.order == 0


@pytest.mark.parametrize("name", SCENARIOS)
def test_recording_of_every_scenario(name: str) -> None:
    scenario = SCENARIOS[name]
    recording = simulate(scenario, rng())
    dt, run_in = (0.01, 808) if scenario.changes else (0.02, 400)
    samples = round(scenario.duration / dt)
    assert (recording.dt, recording.run_in, recording.samples) == (dt, run_in, samples)
    assert recording.time[0] == -run_in * dt
    assert recording.time[run_in] == 0.0
    assert recording.u.shape == (scenario.runs, samples + run_in)
    assert recording.ft is not None
    assert recording.fd is not None
    assert name in recording.source
    if scenario.recorder is not None:
        return  # it rounds, shifts and filters
    np.testing.assert_array_equal(recording.e, recording.ft - recording.x)
    for signal, forcing in ((recording.ft, scenario.target), (recording.fd, scenario.disturbance)):
        expected = np.zeros(samples + run_in) if forcing is None else forcing.at(recording.time)
        np.testing.assert_array_equal(signal, np.tile(expected, (scenario.runs, 1)))


def test_runs_have_the_same_forcing_and_independent_remnants() -> None:
    recording = simulate(replace(NOMINAL, runs=40), rng())
    np.testing.assert_array_equal(recording.ft[0], recording.ft[39])
    forced = simulate(without_remnant(NOMINAL), rng()).u
    remnant = recording.u - forced
    np.testing.assert_allclose(remnant.mean(axis=0), 0.0, atol=5.0 * np.std(remnant) / 40**0.5)
    correlation = np.corrcoef(remnant)[np.triu_indices(40, 1)]
    assert np.max(np.abs(correlation)) < 0.5
    assert abs(correlation.mean()) < 0.01


def test_recording_is_periodic_without_remnant_and_not_with_it() -> None:
    def mismatch(recording: Recording) -> float:
        """RMS of the run-in against the last 8 s, one period later, over that of u."""
        u = recording.u[0]
        return float(np.std(u[:400] - u[4096:]) / np.std(u))

    assert mismatch(simulate(without_remnant(NOMINAL), rng())) < 1e-9
    assert mismatch(simulate(NOMINAL, rng())) > 0.3


def test_remnant_does_not_wrap_round_the_recording() -> None:
    # Were it periodic in the recording, its ends would be neighbours and so nearly equal.
    alone = replace(NOMINAL, target=None, disturbance=None, runs=50)
    u = simulate(alone, rng()).u
    neighbours = np.std(u[:, 1] - u[:, 0])
    assert np.std(u[:, 0] - u[:, -1]) > 10.0 * neighbours


def test_unstable_scenario_is_refused() -> None:
    scenario = replace(NOMINAL, name="wild", element=element_named("6/s^2"))
    with pytest.raises(InputError, match=r"^scenario wild: the closed loop is unstable"):
        simulate(scenario, rng())


# ------------------------------------------------------------------ the independent oracle
#
# A simulation in the time domain, with nothing of the package but the forcing functions:
# every transfer function as a difference equation that is exact for inputs linear between
# fine steps, every delay a whole number of fine steps of the stored signal.  Since each path of
# the pilot is delayed by at least 0.29 s, the loop is worked off in blocks of that length.


class Exact:
    """A transfer function under a first-order hold, with its state kept between blocks."""

    def __init__(self, top: list[float], bottom: list[float], step: float) -> None:
        b, a, _ = cont2discrete((top, bottom), step, method="foh")
        self._b, self._a = np.ravel(b), np.ravel(a)
        self._state = np.zeros(self._a.size - 1)

    def __call__(self, samples: FloatArray) -> FloatArray:
        answer, self._state = lfilter(self._b, self._a, samples, zi=self._state)
        return np.asarray(answer)


Signal = Callable[[FloatArray], FloatArray]
Factors = Sequence[list[float]]


def nothing(time: FloatArray) -> FloatArray:
    return np.zeros(time.size)


def fine_samples(forcing: Forcing | None, time: FloatArray) -> FloatArray:
    """Samples of a forcing function, halfway at a jump, which a linear hold then centres."""
    if forcing is None:
        return np.zeros(time.size)
    near = (
        sharp(forcing, t) if isinstance(forcing, Steps) else forcing.at(t)
        for t in (time - 1e-7, time + 1e-7)
    )
    return 0.5 * sum(near)


def recorded(signal: FloatArray, step: float, first: int) -> FloatArray:
    """Samples of the window from a fine signal, behind the recorder's anti-aliasing filter."""
    # Held and faded out, since the transform joins the two ends.
    fade = 0.5 * (1.0 + np.cos(np.linspace(0.0, np.pi, round(8.0 / step))))
    faded = np.concatenate([signal, signal[-1] * np.ones(round(2.0 / step)), signal[-1] * fade])
    spectrum = np.fft.rfft(faded) * anti_aliasing(
        2.0 * np.pi * np.fft.rfftfreq(faded.size, step), DT
    )
    filtered = np.fft.irfft(spectrum, n=faded.size)
    return filtered[first + np.arange(SAMPLES) * round(DT / step)]


def time_domain(
    scenario: Scenario, begin: float, step: float, remnant: Signal = nothing
) -> tuple[FloatArray, FloatArray]:
    """Samples of u and x in the measurement window, from rest at `begin`."""
    beyond = scenario.duration + scenario.model.ahead
    time = np.arange(round(begin / step), round(beyond / step)) * step
    signals = {name: np.zeros(time.size) for name in ("e", "x", "acceleration")}
    signals["ft"] = fine_samples(scenario.target, time)
    fd, u = fine_samples(scenario.disturbance, time), remnant(time)
    paths = paths_of(scenario, step)
    element = scenario.element
    vehicle = Exact(list(element.numerator), list(element.denominator), step)
    block = min((late for given, _, late in paths if given != "ft"), default=time.size)
    for start in range(0, time.size, block):
        now = np.arange(start, min(start + block, time.size))
        for given, transfer, late in paths:
            before = signals[given][np.clip(now - late, 0, time.size - 1)]
            u[now] += transfer(np.where(now >= late, before, 0.0))
        signals["x"][now] = vehicle(u[now] + fd[now])
        signals["acceleration"][now] = element.numerator[0] * (u[now] + fd[now])  # of K/s^2
        signals["e"][now] = signals["ft"][now] - signals["x"][now]
    first, x = round(-begin / step), signals["x"]
    if isinstance(scenario.target, Steps) or isinstance(scenario.disturbance, Steps):
        return recorded(u, step, first), recorded(x, step, first)
    at_samples = first + np.arange(SAMPLES) * round(DT / step)
    return u[at_samples], x[at_samples]


def assert_agrees(
    recording: Recording, simulated: tuple[FloatArray, FloatArray], tolerance: float
) -> None:
    """Relative RMS difference of u, x and e in the measurement window."""
    u, x = simulated
    target = recording.window(recording.ft)[0]
    for name, signal in (("u", u), ("x", x), ("e", target - x)):
        window = recording.window(getattr(recording, name))[0]
        difference = np.sqrt(np.mean((window - signal) ** 2) / np.mean(window**2))
        assert difference < tolerance, name


@pytest.mark.parametrize(
    ("scenario", "begin", "step", "tolerance"),
    [
        # Steps start from rest; multisines need the transient of the start to die out.
        (SCENARIOS["nominal"], -120.0, 1e-3, 3e-5),
        (SCENARIOS["single"], -120.0, 1e-3, 3e-5),
        (SCENARIOS["target-step"], -8.0, 2e-4, 2e-4),
        (SCENARIOS["disturbance-step"], -8.0, 2e-4, 1e-5),
        *((pilot, -120.0, 1e-3, 1e-4) for pilot in PILOTS.values()),
    ],
)
def test_simulation_agrees_with_an_independent_one_in_the_time_domain(
    scenario: Scenario, begin: float, step: float, tolerance: float
) -> None:
    scenario = without_remnant(scenario)
    assert_agrees(simulate(scenario, rng()), time_domain(scenario, begin, step), tolerance)


def paths_of(scenario: Scenario, step: float) -> list[tuple[str, Exact, int]]:
    """By hand, the paths of a pilot: input, transfer, delay; a negative one is ahead."""
    v = dict(zip(scenario.model.keys, scenario.truth, strict=True))
    if scenario.model.name == "crossover":  # of 2/s
        return [("e", Exact([v["wc"] / 2.0], [1.0], step), round(v["tde"] / step))]
    ff, lead, rate = v["fnm"] ** 2, [v.get("tlead", 0.0), 1.0], [1.0, 0.0]
    muscle = [1.0, 2.0 * v["dnm"] * v["fnm"], ff]

    def path(
        on: str, gain: float, late: float, top: Factors = (), bottom: Factors = ()
    ) -> tuple[str, Exact, int]:
        above, below = np.array([gain * ff]), np.array(muscle)
        for factor in top:
            above = np.polymul(above, factor)
        for factor in bottom:
            below = np.polymul(below, factor)
        return on, Exact(above.tolist(), below.tolist(), step), round(late / step)

    match scenario.model.name:
        case "preview":
            far, near = ([v[key], 1.0] for key in ("tlagf", "tlagn"))
            return [
                path("ft", v["Kvis"] * v["Kf"], v["tdvis"] - v["tlookf"], [lead], [far]),
                path("x", -v["Kvis"], v["tdvis"], [lead]),
                path("ft", v["Kn"], v["tdvis"] - v["tlookn"], [rate], [near]),
            ]
        case "look-ahead":
            return [
                path("ft", v["Kt"], -v["tlook"]),
                path("x", -v["Kvis"], v["tdvis"], [], [[v["tlag"], 1.0]]),
            ]
        case "following":
            return [path("ft", v["Kt"], v["tdt"], [], [[v["tlagt"], 1.0]])]
    leads = [lead, lead] if scenario.model.name.startswith("lead2") else [lead]
    leads += [[v[key], 1.0] for key in ("tleadlow",) if key in v]
    lags = [[v[key], 1.0] for key in ("tlag", "tlaglow") if key in v]
    found = [path("e", v["Kvis"], v["tdvis"], leads, lags)]
    if "Km" in v:
        found.append(path("x", -v["Km"], v["tdm"], [rate]))
    if "Kvest" in v:  # on the acceleration itself where that may jump
        jumps = scenario.element.denominator == (1.0, 0.0, 0.0)
        on, rates = ("acceleration", []) if jumps else ("x", [rate, rate])
        canals = [[0.1, 1.0], *rates]
        found.append(path(on, -v["Kvest"], v["tdvest"], canals, [[6.0, 1.0]]))
    if "Kt" in v:
        found.append(path("ft", v["Kt"], v["tdt"], [rate], [[v["tlagt"], 1.0]]))
    return found


class KnownNoise:
    """In place of a generator: "white noise" that is a sum of known sines over the grid."""

    sines = ((20, 1.0, 0.3), (57, -0.8, 1.1), (150, 1.3, 2.0), (401, 2.0, -0.7))

    def __init__(self) -> None:
        self.grid = 0

    def standard_normal(self, shape: tuple[int, int]) -> FloatArray:
        self.grid = shape[1]
        turns = 2.0 * np.pi * np.arange(self.grid) / self.grid
        return np.array([sum(a * np.cos(k * turns + p) for k, a, p in self.sines)])

    def after(self, remnant: Remnant, level: float, run_in: float) -> Signal:
        """The same noise through the remnant's filter, at any time."""

        def signal(time: FloatArray) -> FloatArray:
            total = np.zeros(time.size)
            for k, amplitude, phase in self.sines:
                w = 2.0 * math.pi * k / (self.grid * DT)
                f, z = remnant.frequency, remnant.damping
                response = f * f / complex(f * f - w * w, 2.0 * z * f * w)
                turn = w * (time + run_in) + phase + math.atan2(response.imag, response.real)
                total += level * amplitude * abs(response) * np.cos(turn)
            return total

        return signal


@pytest.mark.parametrize("name", ["nominal", "single"])
def test_simulation_with_a_known_remnant_agrees_with_the_independent_one(name: str) -> None:
    scenario = with_remnant(SCENARIOS[name], level=0.3)
    noise = KnownNoise()
    recording = simulate(scenario, noise)  # type: ignore[arg-type]
    signal = noise.after(scenario.remnant, 0.3 * UNIT_LEVEL, run_in=8.0)
    without = simulate(without_remnant(scenario), rng())
    assert np.std(recording.u - without.u) > 0.1 * np.std(without.u)
    assert_agrees(recording, time_domain(scenario, -120.0, 1e-3, signal), 3e-5)


def test_a_recorder_rounds_filters_and_adds_noise() -> None:
    scenario = replace(scenario_named("nominal"), duration=40.96, run_in=0.0)
    plain = simulate(scenario, np.random.default_rng(3))
    through = simulate(replace(scenario, recorder=Recorder()), np.random.default_rng(3))
    assert through.e.shape == plain.e.shape
    assert through.dt == plain.dt
    # Another grid of the same remnant, but the forcing functions are where they were.
    np.testing.assert_allclose(through.ft, plain.ft, atol=1e-9)
    rounded = simulate(replace(scenario, recorder=Recorder(bits=10)), np.random.default_rng(3))
    step = 2.0 * 2.0 * np.abs(through.x).max() / 2**10
    np.testing.assert_allclose(rounded.x / step, np.round(rounded.x / step), atol=1e-6)
    assert np.abs(rounded.x - through.x).max() <= 0.5 * step * (1.0 + 1e-9)
    noisy = simulate(
        replace(scenario, recorder=Recorder(noise=(0.0, 0.0, 1e-2), makes_error=True)),
        np.random.default_rng(3),
    )
    added = noisy.x - through.x
    assert added.std() == pytest.approx(1e-2 * np.sqrt(np.mean(through.x**2)), rel=0.1)
    np.testing.assert_allclose(noisy.e, noisy.ft - noisy.x, atol=1e-12)
    # A filter of all signals alike leaves the element between u + fd and x as it is.
    filtered = simulate(
        replace(scenario, recorder=Recorder(order=4, corner=0.5)), np.random.default_rng(3)
    )
    found = identified_element(filtered).element
    expected = scenario.element.response(np.array([3.0]))
    np.testing.assert_allclose(found.response(np.array([3.0])), expected, rtol=0.01)


def test_a_population_of_recorders_is_what_it_says() -> None:
    population = POPULATIONS["population-recorded"]
    drawn = [population.drawn(np.random.default_rng(seed)) for seed in range(12)]
    assert all(scenario.recorder is not None for scenario in drawn)
    assert {scenario.dt for scenario in drawn} > {0.04, 0.01}
    assert len({scenario.truth for scenario in drawn}) == 12
