"""The recording: what it holds, what it refuses and in which words."""

from __future__ import annotations

import copy
import pickle
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from pilotid.recording.recording import ABSENT, SIGNALS, Recording, joined
from pilotid.support.types import FloatArray, InputError

DT = 0.05
SAMPLES = 240  # 12 s


def signals(runs: int = 2, samples: int = SAMPLES, seed: int = 1) -> dict[str, FloatArray]:
    e, u, x = np.random.default_rng(seed).standard_normal((3, runs, samples))
    return {"e": e, "u": u, "x": x}


def make(content: Mapping[str, object] | None = None, **changes: object) -> Recording:
    """A good recording, with some of its fields changed."""
    fields = {"dt": DT, **signals(), "source": "flight.csv", **(content or {}), **changes}
    return Recording(**fields)  # type: ignore[arg-type]


def refused(words: str, **changes: object) -> None:
    """Refused in one line that begins with the source."""
    with pytest.raises(InputError, match=words) as caught:
        make(**changes)
    message = str(caught.value)
    assert message.startswith("flight.csv: ")
    assert len(message.splitlines()) == 1


def spoilt(name: str, where: tuple[int, int], value: float) -> FloatArray:
    array = signals()[name] if name in signals() else np.zeros((2, SAMPLES))
    array[where] = value
    return array


# ------------------------------------------------------------------ what it holds


@pytest.mark.parametrize("name", SIGNALS)
def test_signals_are_read_only(name: str) -> None:
    recording = make(ft=np.zeros((1, SAMPLES)), fd=np.zeros((2, SAMPLES)))
    with pytest.raises(ValueError, match="read-only"):
        getattr(recording, name)[0, 0] = 1.0


def test_integers_and_single_precision_become_doubles_and_a_row_is_one_run() -> None:
    content = signals()
    row = Recording(dt=DT, **{name: signal[0] for name, signal in content.items()})
    assert (row.runs, row.samples, *row.u[0]) == (1, SAMPLES, *content["u"][0])
    recording = make(e=(100.0 * content["e"]).astype(np.int16), x=content["x"].astype(np.float32))
    assert {getattr(recording, name).dtype for name in ("e", "u", "x")} == {np.dtype(np.float64)}
    np.testing.assert_array_equal(recording.e, np.trunc(100.0 * content["e"]))


def test_time_is_negative_in_the_run_in_and_zero_at_the_window() -> None:
    recording = make(run_in=30)
    assert recording.time.shape == (SAMPLES,)
    assert recording.time[0] == pytest.approx(-1.5)
    assert recording.time[30] == 0.0
    np.testing.assert_allclose(np.diff(recording.time), DT, rtol=1e-12)
    assert np.all((recording.time < 0.0) == (np.arange(SAMPLES) < 30))
    assert (recording.runs, recording.samples) == (2, 210)
    assert recording.duration == pytest.approx(10.5)
    np.testing.assert_array_equal(recording.window(recording.u), recording.u[:, 30:])


@pytest.mark.parametrize("name", ["ft", "fd"])
def test_one_forcing_function_serves_all_runs(name: str) -> None:
    forcing = np.arange(float(SAMPLES))[None]
    stored = getattr(make({name: forcing}), name)
    np.testing.assert_array_equal(stored, np.repeat(forcing, 2, axis=0))


# ------------------------------------------------------------------ what it refuses


@pytest.mark.parametrize(
    ("words", "name", "wrong"),
    [
        *(("the sampling interval is", "dt", dt) for dt in (0.0, -0.02, np.nan, np.inf)),
        *(("whole numbers", "lines", lines) for lines in ("abc", {"ft": (6.5,)})),
        ("whole numbers", "dt", "a"),
        ("whole numbers", "run_in", 1.5),
        ("whole numbers", "lead_in", None),
        ("array of real numbers", "u", np.ma.masked_array(signals()["u"], np.eye(2, SAMPLES))),
        ("must be an array of real numbers", "u", signals()["u"] > 0.0),
        ("must be an array of real numbers", "u", signals()["u"].astype(str)),
    ],
)
def test_what_is_no_number_or_array_of_them_is_refused(words: str, name: str, wrong: Any) -> None:
    refused(words, **{name: wrong})


@pytest.mark.parametrize("name", ["e", "x", "ft", "fd"])
@pytest.mark.parametrize("shape", [(2, SAMPLES - 1), (3, SAMPLES), (1, SAMPLES + 1)])
def test_signals_of_different_shapes_are_refused(name: str, shape: tuple[int, int]) -> None:
    words = f"signal {name} is of the shape {shape} and u of (2, 240)"
    refused(re.escape(words), **{name: np.ones(shape)})


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("value", [np.nan, -np.inf, 1.1e100])
def test_sample_that_is_no_number_is_refused_with_its_place(name: str, value: float) -> None:
    words = re.escape(f"signal {name} is {value:g} at sample 12 of run 2;")
    refused(words, **{name: spoilt(name, (1, 11), value)})


def test_control_that_is_constant_but_for_the_run_in_is_refused() -> None:
    u = signals()["u"]
    u[0, 20:] = 0.3
    refused("the control u is constant in run 1", u=u, run_in=20)
    u[0, 30] = 0.4
    assert make(u=u, run_in=20).samples == 220
    refused("the control u is constant in run 1", u=1e-200 * u)
    refused("the measurement window lasts", lead_in=np.nan)


@pytest.mark.parametrize(("samples", "run_in"), [(199, 0), (240, 41), (1, 0)])
def test_window_shorter_than_ten_seconds_is_refused(samples: int, run_in: int) -> None:
    content = {name: array[:, :samples] for name, array in signals().items()}
    refused("the measurement window lasts .* at least 10 s", run_in=run_in, **content)


# ------------------------------------------------------------------ joining runs


def other(**changes: object) -> Recording:
    return make(signals(runs=1, seed=2), **{"source": "second.csv", **changes})


def test_joined_recordings_are_the_runs_of_one() -> None:
    forcing = np.arange(float(SAMPLES))[None]
    first = make(ft=forcing, run_in=20, lines={"ft": (3,)}, units={"u": "deg"})
    second = other(ft=-forcing, run_in=20, lines={"ft": (3, 5)})
    both = joined([first, second])
    assert (both.runs, both.samples, both.run_in, both.dt) == (3, 220, 20, DT)
    for name in ("e", "u", "x", "ft"):
        stacked = np.concatenate([getattr(first, name), getattr(second, name)])
        np.testing.assert_array_equal(getattr(both, name), stacked)
    assert both.fd is None
    assert (dict(both.lines), dict(both.units)) == ({"ft": (3, 5)}, {"u": "deg"})
    assert "flight.csv" in both.source


@pytest.mark.parametrize(
    ("second", "what"),
    [
        (other(dt=0.06), "sampling interval (0.06) differs from that of flight.csv (0.05)"),
        (
            make(signals(1, 250), source="second.csv"),
            "number of samples (250) differs from that of flight.csv (240)",
        ),
        (
            other(origin={"x": ABSENT}),
            "set of signals (e u) differs from that of flight.csv (e u x)",
        ),
    ],
    ids=["sampling interval", "length", "signals"],
)
def test_recordings_that_differ_are_not_joined(second: Recording, what: str) -> None:
    with pytest.raises(InputError) as caught:
        joined([make(), make(), second])
    message = str(caught.value)
    assert message.startswith(f"second.csv: the {what}")
    assert len(message.splitlines()) == 1


# ------------------------------------------------------------------ what Python may hand over


def test_a_recording_can_be_pickled_and_copied() -> None:
    recording = make(lines={"ft": (1, 2)}, units={"u": "cm"}, run_in=20)
    for other in (pickle.loads(pickle.dumps(recording)), copy.deepcopy(recording)):
        assert other.to_dict() == recording.to_dict()
        np.testing.assert_array_equal(other.u, recording.u)
        assert not other.u.flags.writeable


def test_run_ins_of_recordings_that_are_joined_have_the_length_that_all_have() -> None:
    signals = np.random.default_rng(1).standard_normal((2, 3, 1, 2100))
    first, second = (
        Recording(dt=0.01, e=e[:, skip:], u=u[:, skip:], x=x[:, skip:], run_in=100 - skip)
        for skip, (e, u, x) in zip((0, 40), signals, strict=True)
    )
    whole = joined([first, second])
    assert (whole.runs, whole.run_in, whole.samples) == (2, 60, 2000)
    assert np.array_equal(whole.window(whole.u)[0], first.window(first.u)[0])
    assert np.array_equal(whole.u[1], second.u[0])
