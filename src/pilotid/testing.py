"""What every method promises, for the tests of a method in a package or file of your own.

from pilotid.testing import check_method

def test_my_method():
    check_method(Mine())
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass, replace
from typing import Any

import numpy as np

from pilotid.datasets import SCENARIOS as KNOWN
from pilotid.datasets import simulate
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.method import Method, fault_of, identify, method_fault, signals_in
from pilotid.model.catalogue import model_named
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.support.naming import labelled

#: Scenarios whose recordings a method is tried on, by the model that is fitted.
SCENARIOS = {"single": KNOWN["single"], "multi": KNOWN["nominal"]}
#: Outcomes that are the method's fault.
FAULTS = (Outcome.CRASHED, Outcome.INVALID, Outcome.OUT_OF_MEMORY)
#: Values of a usable estimate lie within this factor of the truth: positions are names here.
FACTOR = 5.0


def check_method(method: Method, models: Sequence[str] = tuple(SCENARIOS)) -> None:
    """Check that a method keeps the contract; it takes about fifteen fits of each model.

    Parameters
    ----------
    method
        The method.
    models
        Names of the models to fit: ``single``, ``multi`` or both.

    Raises
    ------
    AssertionError
        If it does not; the message says what is wrong.
    """
    check_settings(method)
    outcomes = [_check_fits(method, name) for name in models]
    if not any(outcome.usable for outcome in outcomes):
        ends = "; ".join(sorted({outcome.value for outcome in outcomes}))
        raise AssertionError(f"{method.name}: finds nothing in an ordinary recording ({ends})")


def check_settings(method: Method) -> None:
    """Check that a method is a frozen dataclass of settings that other processes understand."""
    fault = method_fault(method)
    _require(not fault, fault)
    name = method.name
    given: Any = method
    frozen = is_dataclass(given) and vars(type(given))["__dataclass_params__"].frozen
    _require(frozen, f"{name}: must be a frozen dataclass, so that a fit leaves nothing behind")
    try:
        equal = hash(replace(given)) == hash(given)
        other = pickle.loads(pickle.dumps(method))
    except Exception as error:
        raise AssertionError(f"{name}: cannot be hashed and pickled ({error})") from error
    _require(equal, f"{name}: two objects of the same settings have different hashes")
    _require(
        other == method and labelled(name, other) == labelled(name, method),
        f"{name}: is another one after it was pickled; give its settings an __eq__",
    )


def check_estimate(estimate: Estimate, method: Method, model: PilotModel) -> None:
    """Check that an estimate makes sense, whatever its outcome; see `check_method`.

    Parameters
    ----------
    estimate
        What the method returned.
    method, model
        The method, and the model that it was asked to fit.

    Raises
    ------
    AssertionError
        If it does not; the message says what is wrong.
    """
    name = method.name
    fault = fault_of(estimate, model)
    _require(not fault, f"{name}: {fault}")
    _require(estimate.method == name, f"{name}: signs its estimates with '{estimate.method}'")
    _require(estimate.outcome not in FAULTS, f"{name}: {estimate.sentence}")


def recording_for(model: str) -> Recording:
    """An ordinary recording, of the scenario in `SCENARIOS`."""
    return simulate(SCENARIOS[model], np.random.default_rng(11))


def _check_fits(method: Method, name: str) -> Outcome:
    """Check a method with one model; returns the outcome with an ordinary recording."""
    model, recording = model_named(name), recording_for(name)
    before = signals_in(recording)
    first = identify(method, recording, model, np.random.default_rng(2))
    words = f"{method.name}: changed the recording; work on copies of its signals"
    _require(signals_in(recording) == before, words)
    check_estimate(first, method, model)
    again = identify(method, recording, model, np.random.default_rng(2))
    same = np.allclose(again.values, first.values, rtol=1e-6, equal_nan=True)
    _require(
        same and again.outcome is first.outcome,
        f"{method.name}: gives other values with the same random generator; take every random "
        "number from the one that is passed",
    )
    if first.outcome.usable:
        truth = SCENARIOS[name].values
        far = np.flatnonzero(np.abs(np.log(np.abs(first.values / truth))) > np.log(FACTOR))
        keys = ", ".join(model.keys[i] for i in far)
        _require(not far.size, f"{method.name}: {keys} far from the truth; are values in order?")
    for spoil in DIFFICULT:
        check_estimate(
            identify(method, spoil(recording), model, np.random.default_rng(2)), method, model
        )
    return first.outcome


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise AssertionError(sentence)


# -------------------------------------------------------------------- difficult recordings


def control_is_noise(recording: Recording) -> Recording:
    """Nobody at the stick."""
    noise = np.random.default_rng(7).standard_normal(recording.u.shape)
    return replace(recording, u=noise)


def tiny(recording: Recording) -> Recording:
    """Signals in units that are far too large, by a power of two so that none is rounded."""
    return recording.with_arrays({n: 2.0**-40 * s for n, s in recording.arrays.items()})


def bare(recording: Recording) -> Recording:
    """No forcing functions and no run-in."""
    return replace(recording, ft=None, fd=None, run_in=0, lines={})


DIFFICULT: tuple[Callable[[Recording], Recording], ...] = (control_is_noise, tiny, bare)
