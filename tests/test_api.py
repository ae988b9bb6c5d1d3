"""What a user types in a notebook, by names and by objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pilotid
from pilotid import ARX, MLE, MODELS, MLEWhite, Outcome, Study, identify, simulate
from pilotid.estimate.method import fit_all
from pilotid.methods import METHODS
from pilotid.model.channel import Channel
from pilotid.study.table import read_study
from pilotid.support.types import InputError

RECORDING = simulate("nominal", 3)


def test_names_and_objects_give_the_same_estimate() -> None:
    by_name = identify(RECORDING, "multi", "mle-white")
    by_object = identify(MLEWhite(), RECORDING, MODELS["multi"], 1)
    np.testing.assert_array_equal(by_name.values, by_object.values)
    default = identify(recording=RECORDING, model="multi")
    assert default.method == "mle"
    with_settings = identify("arx(memory=none)", RECORDING, "multi")
    np.testing.assert_array_equal(
        with_settings.values, identify(ARX(memory=None), RECORDING, "multi").values
    )


def test_the_default_seed_gives_what_the_command_line_prints() -> None:
    (printed,) = fit_all(RECORDING, MODELS["multi"], {"mle": MLE()}, 1).estimates
    np.testing.assert_array_equal(identify(RECORDING, "multi", "mle").values, printed.values)
    own = identify(RECORDING, "multi", "mle", np.random.default_rng(5))
    assert own.outcome is Outcome.CONVERGED


@pytest.mark.parametrize("method", METHODS.values(), ids=lambda m: m.name)
@pytest.mark.parametrize(("name", "channel"), [("e", "visual"), ("x", "vestibular")])
def test_a_channel_without_input_is_not_identified(
    method: pilotid.Method, name: str, channel: str
) -> None:
    still = replace(RECORDING, **{name: np.zeros_like(RECORDING.e)})
    estimate = identify(method, still, "multi")
    assert estimate.outcome is Outcome.NOT_APPLICABLE
    assert estimate.message == (f"{name} does not move, so that the {channel} channel has no input")


def test_a_study_is_compared_and_becomes_a_data_frame(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    study = Study("single", "mle-white", 2)
    found = study.run_in(tmp_path, workers=1)
    frame = found.to_dataframe()
    assert list(frame["parameter"]) == 2 * list(MODELS["single"].keys)
    assert read_study(tmp_path).to_dataframe().equals(frame)
    scores = found.to_dataframe(summary=True)
    assert list(scores["n"]) == 6 * [2]  # of each parameter, and of all
    gain = frame[frame["parameter"] == "Kvis"]["value"]
    assert scores["bias"][0] == pytest.approx(gain.mean() - 0.32)
    again = pilotid.compare("single", "mle-white", 2, out=tmp_path, workers=1)
    assert again.to_dataframe().equals(frame)


class Raising(MLEWhite):
    """A method with a bug."""

    name = "raising"

    def fit(self, *_: object) -> pilotid.Estimate:
        raise ZeroDivisionError("no such luck")


def test_what_a_method_raises_is_an_outcome_and_its_traceback_comes_if_asked(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    estimate = identify(Raising(), RECORDING, "single")
    assert estimate.outcome is Outcome.CRASHED
    assert estimate.message == "ZeroDivisionError: no such luck"
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("PILOTID_TRACEBACK", "1")
    identify(Raising(), RECORDING, "single")
    assert 'raise ZeroDivisionError("no such luck")' in capsys.readouterr().err


@pytest.mark.parametrize(
    "call",
    [
        lambda: pilotid.design(minimise="foo"),
        lambda: pilotid.compare(["single"], ["mle-white"], 0, out="c"),
        lambda: pilotid.trust(RECORDING, "single", replications=0, out="c"),
        lambda: pilotid.identify("mle-white", 3, "single"),  # type: ignore[arg-type]
        lambda: pilotid.identify("mle-white", RECORDING, 3),  # type: ignore[arg-type]
        lambda: pilotid.simulate(3),  # type: ignore[arg-type]
        lambda: Channel("v", "error", 1, ()),
    ],
)
def test_python_is_as_careful(call: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError):
        call()
