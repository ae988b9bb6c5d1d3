"""Designs of forcing functions: derivatives, optima against a conic solver, limits, files."""

from __future__ import annotations

import json
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import NOMINAL, SINGLE_LOOP, simulated_chance
from scipy.optimize import linprog, minimize

import pilotid
from pilotid.cli.main import main
from pilotid.datasets import scenario_named
from pilotid.datasets.experiments import experiment_of
from pilotid.datasets.forcing import PERIOD, Multisine, paper_target
from pilotid.datasets.remnant import TabulatedRemnant
from pilotid.designing.design import (
    Design,
    RemnantPower,
    crest_factor,
    design,
    low_crest,
    wrong_pilots,
)
from pilotid.designing.limits import Limits, linear
from pilotid.designing.lines import (
    chosen_lines,
    loop_of,
    powers_of,
    reference_lines,
    shares_like,
    widening,
)
from pilotid.designing.optimum import (
    Aim,
    Criterion,
    Goal,
    InfeasibleError,
    Kind,
    Limit,
    Over,
    goal_of,
    minimise_within,
)
from pilotid.designing.output import forcing_table
from pilotid.designing.pilots import drawn_pilots, studied, with_truth
from pilotid.designing.planning import plan, read_effect
from pilotid.element.fit import chosen_element
from pilotid.estimates.fitted import fit_all
from pilotid.methods import method_named
from pilotid.pilot.catalogue import MULTI
from pilotid.pilot.element import element_named
from pilotid.theory.bounds import bounds
from pilotid.types import FloatArray, InputError

pytestmark = pytest.mark.numerical


def with_powers(scenario: pilotid.Scenario, powers: FloatArray) -> pilotid.Scenario:
    amplitudes = np.sqrt(2.0 * powers)
    sines, begin = [], 0
    for f in (scenario.target, scenario.disturbance):
        assert isinstance(f, Multisine)
        own = amplitudes[begin : begin + len(f.lines)]
        begin += len(f.lines)
        sines.append(replace(f, amplitudes=tuple(own.tolist())))
    return replace(scenario, target=sines[0], disturbance=sines[1])


def changed() -> FloatArray:
    """Powers unlike those of the reference."""
    return np.asarray(powers_of(NOMINAL) * np.random.default_rng(1).uniform(0.3, 3.0, 24))


# ------------------------------------------------------------------------------- theory


def test_information_is_affine_in_the_powers() -> None:
    loop = loop_of(NOMINAL, reference_lines(NOMINAL))
    powers = changed()
    expected = bounds(experiment_of(with_powers(NOMINAL, powers))).low_pass
    relative = expected / np.outer(NOMINAL.values, NOMINAL.values)
    np.testing.assert_allclose(loop.information.covariance(powers), relative, rtol=1e-6)


def test_slopes_are_those_of_the_bound() -> None:
    information = loop_of(NOMINAL, reference_lines(NOMINAL)).information
    powers = changed()
    slopes = information.slopes(powers)
    for j in (0, 5, 11, 12, 20, 23):
        step = np.eye(24)[j] * 1e-4 * powers[j]
        ahead, behind = (information.covariance(powers + s) for s in (step, -step))
        found = (ahead - behind) / (2.0 * step[j])
        # Entries that all but vanish have the error of the largest.
        np.testing.assert_allclose(found, slopes[j], rtol=1e-4, atol=1e-5 * abs(slopes[j]).max())


def test_variances_are_those_of_the_simulation() -> None:
    loop = loop_of(NOMINAL, reference_lines(NOMINAL))
    powers = powers_of(NOMINAL)
    names = ("e", "u", "x", "dx", "ddx")
    seen = []
    for seed in range(12):
        recording = pilotid.simulate(replace(NOMINAL, runs=8), seed)
        assert recording.fd is not None
        rate = np.gradient(recording.x, recording.dt, axis=1)
        signals = recording.e, recording.u, recording.x, rate, 4.0 * (recording.u + recording.fd)
        seen.append([np.mean(recording.window(signal) ** 2) for signal in signals])
    errors = np.std(seen, axis=0, ddof=1) / np.sqrt(len(seen))
    expected = [loop.variance(name, powers) for name in names]
    assert (np.abs(np.mean(seen, axis=0) - expected) < 5.0 * errors).all()


# ------------------------------------------------------------------------------- goals


OVERS: tuple[Over, ...] = ("mean", "worst")
KINDS: tuple[Kind, ...] = ("A", "D", "E")


def criteria(kind: Kind) -> list[Criterion]:
    rng = np.random.default_rng(3)
    found = []
    for _ in range(3):
        root, factors = rng.standard_normal((4, 4)), rng.standard_normal((6, 4, 2))
        found.append(Criterion(kind, root @ root.T, factors, rng.uniform(0.5, 1.0, 4), 0.7))
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_criteria_are_what_their_names_say(kind: Kind) -> None:
    powers = np.linspace(0.2, 1.2, 6)
    for c in criteria(kind):
        covariance = np.linalg.inv(
            c.base + sum(p * f @ f.T for p, f in zip(powers, c.factors, strict=True))
        )
        expected = {
            "A": c.weights @ np.diag(covariance) / 0.7,
            "D": np.linalg.slogdet(covariance)[1] / 4 - 0.7,
            "E": np.linalg.eigvalsh(covariance)[-1] / 0.7,
        }
        assert c.value(powers) == pytest.approx(expected[kind], rel=1e-10)


# ------------------------------------------------------------------------------- optima


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("over", OVERS)
def test_the_optimum_is_that_of_another_search(kind: Kind, over: Over) -> None:
    goal = Goal(criteria(kind), over)
    found = minimise_within(
        goal, [Limit("all", np.ones(6), 1.0), Limit("first", np.eye(6)[0], 0.1)]
    )
    assert found.powers.min() >= 0.0
    assert found.powers.sum() <= 1.0 + 1e-12
    assert found.value == goal.value(found.powers)
    assert 0.0 <= found.value - found.lower < 1e-6
    for start in np.random.default_rng(2).dirichlet(np.ones(6), 20):
        other = minimize(
            goal.value,
            start,
            method="SLSQP",
            bounds=[(0.0, 0.1), *[(0.0, 1.0)] * 5],
            constraints={"type": "ineq", "fun": lambda p: 1.0 - p.sum()},
        )
        if other.success:
            assert found.value <= other.fun + 1e-6
            if over == "mean" and kind != "E":  # smooth
                assert found.value == pytest.approx(other.fun, rel=1e-4)


@pytest.mark.parametrize("minimise", ["A", "D", "E", "Kvis,tlead"])
@pytest.mark.parametrize("remnant", ["held", "share"])
@pytest.mark.parametrize(
    "most", [1.5, *(pytest.param(most, marks=pytest.mark.long) for most in (1.0, None))]
)
def test_no_step_towards_another_design_is_better(
    minimise: str, remnant: RemnantPower, most: float | None
) -> None:
    """The goal is convex, or falls on the way to whatever is better: steps to corners tell."""
    limits = Limits(e=most, u=most)
    made = design(NOMINAL, minimise, limits=limits, remnant=remnant)
    assert 0.0 <= made.gap < 1e-6
    usual, (loop,) = powers_of(NOMINAL), made.loops
    one = np.ones(usual.size)
    goal = goal_of(Aim(minimise, {}), made.loops, made.references, usual, one)
    rows = linear(limits, made.loops, made.references, usual)
    assert goal.value(loop.told(made.powers)) == pytest.approx(made.optimum.value, rel=1e-9)
    above = [row for row in rows if not row.equal]
    equal = [row for row in rows if row.equal]
    rng = np.random.default_rng(7)
    for _ in range(20):
        corner = linprog(
            rng.standard_normal(usual.size) / usual,
            A_ub=[row.gradient for row in above],
            b_ub=[row.bound for row in above],
            A_eq=[row.gradient for row in equal],
            b_eq=[row.bound for row in equal],
        ).x
        for step in (1e-3, 0.1, 1.0):
            other = (1.0 - step) * made.powers + step * corner
            assert goal.value(loop.told(other)) > made.optimum.value - 1e-6


def test_a_design_with_a_share_is_what_it_says() -> None:
    """Its scenario, with the remnant that it has there, has the errors and the costs told."""
    made = design(NOMINAL, limits=Limits(e=1.2), remnant="share")
    assert made.scenario.remnant.level_is == "ratio"
    assert made.errors == made.errors_if_scaled
    for name, at in made.lines.signals:
        assert made.powers[at].sum() == pytest.approx(powers_of(NOMINAL)[at].sum()), name
    found = bounds(experiment_of(made.scenario)).low_pass
    errors = np.sqrt(np.diag(found) * widening(1, PERIOD)) / NOMINAL.values
    np.testing.assert_allclose(list(made.errors.values()), errors, rtol=2e-3)
    loop = loop_of(made.scenario, reference_lines(made.scenario))
    before = made.loops[0].variance("e", powers_of(NOMINAL))
    assert loop.variance("e", made.powers) / before == pytest.approx(made.costs["e"], rel=2e-3)
    assert made.costs["e"] == pytest.approx(1.2, rel=1e-6)
    held = design(NOMINAL, limits=Limits(e=1.2))
    assert made.errors_if_scaled["tlead"] < held.errors_if_scaled["tlead"]
    with pytest.raises(InputError, match="for one pilot"):
        design(NOMINAL, pilots=drawn_pilots(NOMINAL, 2, 1), remnant="share")
    with pytest.raises(InputError, match="only ratios"):
        design(NOMINAL, limits=Limits(e=1.0, power=None), remnant="share")


@pytest.mark.parametrize("minimise", ["A", "D", "E", "Kvis,tlead"])
def test_designs_keep_their_limits_and_are_no_worse(minimise: str) -> None:
    limits = Limits(e=1.5, u=1.5, du=1.4, x=1.3, ddx=1.3, acceleration=3.6, high=0.9)
    made = design(NOMINAL, minimise, limits=limits)
    assert made.gains[0] < 1.0
    assert max(made.costs["x"], made.costs["ddx"]) <= 1.3 + 1e-9
    assert 3.0 * made.rms["ddx"] <= 3.6 + 1e-9
    assert 0.0 <= made.gap < 1e-3
    assert max(made.costs["e"], made.costs["u"]) <= 1.5 + 1e-9
    assert made.costs["du"] <= 1.4 + 1e-9
    powers = made.powers[dict(made.lines.signals)["ft"]]
    assert powers[made.lines.omega[:12] > 0.8 * made.loops[0].crossover].sum() < 0.9 * powers.sum()
    for _, at in made.lines.signals:
        assert made.powers[at].sum() <= powers_of(NOMINAL)[at].sum() * (1.0 + 1e-9)
    share = made.powers[:12] / made.powers[:12].sum()
    assert (share > 0.0999 * powers_of(NOMINAL)[:12] / powers_of(NOMINAL)[:12].sum()).all()


def test_prices_say_what_a_limit_costs() -> None:
    at = {e: design(NOMINAL, limits=Limits(e=e)) for e in (1.5, 1.505)}
    (binding,) = [p for name, p in at[1.5].optimum.prices if name.startswith("e=")]
    room = 1.5 - at[1.5].loops[0].free["e"] / (at[1.5].loops[0].variance("e", powers_of(NOMINAL)))
    saved = at[1.5].optimum.value - at[1.505].optimum.value
    assert saved == pytest.approx(binding * 0.005 / room, rel=0.05)


@pytest.mark.long
def test_a_design_for_several_pilots() -> None:
    pilots = drawn_pilots(NOMINAL, 4, 1)
    assert pilots == drawn_pilots(NOMINAL, 4, 1)
    limits = Limits(e=1.5, u=1.5)
    mean = design(NOMINAL, limits=limits, pilots=pilots)
    worst = design(NOMINAL, limits=limits, pilots=pilots, over="worst")
    own = [design(pilot, limits=limits).gains[0] for pilot in pilots]
    assert len(worst.gains) == 4
    assert max(worst.gains) < 1.0
    assert all(g >= o - 1e-6 for g, o in zip(worst.gains, own, strict=True))
    # In the mean the limits hold in the mean, which leaves more room.
    assert np.mean(np.square(mean.gains)) <= np.mean(np.square(worst.gains)) + 1e-6
    axis = {
        over: np.square(design(NOMINAL, "E", limits=limits, pilots=pilots, over=over).gains)
        for over in OVERS
    }
    roomy = design(NOMINAL, limits=replace(limits, each=False), pilots=pilots, over="worst")
    assert max(roomy.gains) <= max(worst.gains) + 1e-6
    assert axis["mean"].mean() <= axis["worst"].mean() + 1e-6
    assert axis["worst"].max() < 1.0


# ------------------------------------------------------------------------------- wishes


def test_wishes_are_met_in_the_shortest_time() -> None:
    wanted = {"tdvest": 0.01, "Kvest": 0.03}
    made = design(NOMINAL, wanted=wanted, limits=Limits(e=1.5, u=1.5))
    assert made.unrounded <= made.scenario.duration < made.unrounded + PERIOD
    assert made.errors["tdvest"] <= 0.01
    assert made.errors["Kvest"] <= 0.03
    # At the unrounded length the harder wish is met exactly.
    longer = made.scenario.duration * widening(1, made.unrounded)
    longer /= made.unrounded * widening(1, made.scenario.duration)
    reached = max(made.errors[key] * np.sqrt(longer) / wanted[key] for key in wanted)
    assert reached == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"limits": Limits(e=0.8)}, "remnant alone"),
        ({"limits": Limits(travel=0.01)}, "travel=0.01 .* remnant alone"),
        ({"limits": Limits(above=0.01, beyond=1.0, floor=0.9)}, "keep .*(floor|above)"),
        ({"minimise": "Kfoo"}, "choose from Kvis"),
        ({"wanted": {"tdvest": 0.001}, "at_most": 300.0}, "the limit that binds most is power=1"),
    ],
)
def test_the_impossible_is_one_sentence(given: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as refused:
        design(NOMINAL, **given)  # type: ignore[arg-type]
    assert "\n" not in str(refused.value)


def test_limits_that_exclude_one_another_are_named() -> None:
    rows = [
        Limit("low", np.array([1.0, 1.0]), 1.0),
        Limit("high", np.array([-1.0, -1.0]), -2.0),
        Limit("else", np.array([1.0, 0.0]), 9.0),
    ]
    with pytest.raises(InfeasibleError, match=r"(low and high)|(high and low)"):
        minimise_within(Goal([replace(criteria("A")[0], factors=np.ones((2, 4, 2)))]), rows)


# ------------------------------------------------------------------------------- lines, phases


def test_lines_that_are_asked_for() -> None:
    known = reference_lines(NOMINAL)
    assert chosen_lines(known) is known
    for pick, wrong in (("odd", 2), ("prime", 9)):
        found = chosen_lines(known, 8, pick)  # type: ignore[arg-type]
        both = {*found.target, *found.disturbance}
        assert len(both) == 16
        assert wrong not in both
        assert all(k % 2 for k in both) or pick == "prime"
    half = chosen_lines(known, period=0.5 * PERIOD)
    assert half.period == 0.5 * PERIOD
    assert max(half.omega) == pytest.approx(max(known.omega), rel=0.02)
    with pytest.raises(InputError, match="fewer than 200"):
        chosen_lines(known, 100, "prime")


def test_a_spectrum_on_other_lines() -> None:
    known, powers = reference_lines(NOMINAL), powers_of(NOMINAL)
    own = shares_like(known, powers, known, "fd")
    np.testing.assert_allclose(own, powers[12:] / powers[12:].sum())
    other = chosen_lines(known, 20)
    shares = shares_like(known, powers, other, "ft")
    assert shares.sum() == pytest.approx(1.0)
    low = other.omega[dict(other.signals)["ft"]] < 2.0
    assert shares[low].sum() == pytest.approx(
        powers[:12][known.omega[:12] < 2.0].sum() / powers[:12].sum(), abs=0.03
    )


def test_a_steep_spectrum_has_the_crest_factor_that_phases_can_give() -> None:
    """A few descents find what many do: the rest is up to amplitudes and lines."""
    assert isinstance(NOMINAL.target, Multisine)
    lines, amplitudes = np.array(NOMINAL.target.lines), np.array(NOMINAL.target.amplitudes)
    few, many = (
        crest_factor(lines, amplitudes, low_crest(lines, amplitudes, rng, starts))
        for rng, starts in ((np.random.default_rng(1), 4), (np.random.default_rng(2), 24))
    )
    assert few < 1.01 * many
    assert few < crest_factor(lines, amplitudes, np.zeros(12)) - 0.3


def test_lines_that_both_signals_have() -> None:
    """Runs in which the disturbance has the other sign tell as much as lines of their own would."""
    twice = replace(NOMINAL, runs=2)
    shared = chosen_lines(reference_lines(NOMINAL), shared=True)
    assert shared.shared
    assert shared.target == shared.disturbance == reference_lines(NOMINAL).target
    fewer = chosen_lines(reference_lines(NOMINAL), 8, shared=True)
    assert len(fewer.target) == 8
    assert fewer.target == fewer.disturbance
    made = pilotid.design(twice, limit="e=1.5,u=1.5", shared=True)
    assert made.scenario.alternating
    assert isinstance(made.scenario.disturbance, Multisine)
    # The information of both runs, with the phases that they have, by the bounds of each.
    runs = [
        replace(
            made.scenario,
            runs=1,
            alternating=False,
            disturbance=made.scenario.disturbance.scaled(sign),
        )
        for sign in (1.0, -1.0)
    ]
    both = sum(np.linalg.inv(bounds(experiment_of(run)).low_pass) for run in runs)
    errors = np.sqrt(np.diag(np.linalg.inv(both)) * widening(2, PERIOD)) / NOMINAL.values
    np.testing.assert_allclose(list(made.errors.values()), errors, rtol=1e-6)
    again = bounds(experiment_of(made.scenario)).low_pass
    np.testing.assert_allclose(again, np.linalg.inv(both), rtol=1e-6)
    recording = pilotid.simulate(made.scenario, 1)
    assert recording.fd is not None
    np.testing.assert_array_equal(recording.fd[1], -recording.fd[0])
    table = forcing_table(made)
    np.testing.assert_array_equal(table[:, 3], -table[:, 2])
    pairs, single = plan(made.scenario, "tlead", 0.15), plan(NOMINAL, "tlead", 0.15)
    tlead = made.errors["tlead"] * np.sqrt(2.0 / widening(2, PERIOD))
    assert pairs.error == pytest.approx(np.hypot(tlead, 1.15 * tlead), rel=0.1)
    assert pairs.choices == (2, 4, 6, 8, 10)
    assert single.choices[0] == 1
    with pytest.raises(InputError, match="add --runs 2"):
        design(NOMINAL, lines=shared)
    with pytest.raises(InputError, match="lines of their own"):
        design(replace(made.scenario, alternating=False))


def test_crest_factors() -> None:
    lines = np.array([3, 5, 7, 11, 17, 23, 31, 43, 61, 89], dtype=float)
    amplitudes = np.ones(10)
    phases = low_crest(lines, amplitudes, np.random.default_rng(1))
    assert crest_factor(lines, amplitudes, phases) < 1.8
    assert crest_factor(np.ones(1), np.ones(1), np.zeros(1)) == pytest.approx(
        np.sqrt(2.0), rel=1e-3
    )


# ------------------------------------------------------------------------------- pilots, plans


def test_pilots_of_a_truth_and_of_a_study(tmp_path: Path) -> None:
    slower = with_truth(NOMINAL, {"tdvis": 0.35})
    assert slower.truth[2] == 0.35
    assert slower.remnant.level_is == "gain"
    with pytest.raises(InputError, match="no parameter"):
        with_truth(NOMINAL, {"tdv": 0.3})
    file = tmp_path / "estimates.json"
    file.write_text("{}")
    with pytest.raises(InputError, match="cannot be read as estimates"):
        studied(NOMINAL, file)


def test_the_reference_is_the_users_own_experiment(tmp_path: Path) -> None:
    target = paper_target().scaled(2.0).with_random_phases(np.random.default_rng(1))
    own = replace(NOMINAL, target=target, runs=2, dt=0.04, units=(("x", "m"),))
    recording = pilotid.simulate(own, 3)
    element = chosen_element(recording, element_named("5/s^2"))
    fitted: Any = fit_all(recording, MULTI, {"mle": method_named("mle")}, 1, element).to_dict()
    file = tmp_path / "estimates.json"

    def read(*entries: object, scenario: pilotid.Scenario | None = None) -> pilotid.Scenario:
        file.write_text(json.dumps(entries))
        return studied(scenario, file)[0]

    found = read(fitted)
    assert reference_lines(found) == reference_lines(own)
    np.testing.assert_allclose(powers_of(found), powers_of(own), rtol=1e-6)
    assert found.target is not None
    time = np.arange(0.0, 10.0)
    np.testing.assert_allclose(found.target.at(time), target.at(time), atol=1e-6)
    assert (found.runs, found.dt, found.run_in) == (2, 0.04, 8.0)
    assert found.element.name == "5/s^2"
    assert found.units == (("x", "m"),)
    estimate = fitted["estimates"][0]
    assert found.truth[2] == estimate["parameters"]["tdvis"]["value"]
    assert found.remnant.level == estimate["remnant"]["power_ratio"]
    named = read(fitted, scenario=NOMINAL)
    assert (named.target, named.runs, named.truth) == (NOMINAL.target, 1, found.truth)

    free = deepcopy(fitted)
    free["estimates"][0]["remnant"]["model"] = "AR(2)"
    tabulated = read(free)
    known = estimate["remnant"]["omega"]
    assert isinstance(tabulated.remnant, TabulatedRemnant)
    power = np.abs(tabulated.remnant.filter(np.array(known))) ** 2
    np.testing.assert_allclose(power, estimate["remnant"]["density"])
    # A spectrum that is estimated along with the pilot leaves less to know him by.
    assert (tabulated.remnant.coefficients, tabulated.remnant.band) == (2, max(known))
    more, less = (
        loop_of(s, reference_lines(s)).errors(powers_of(s))
        for coefficients in (0, 20)
        for s in (
            replace(tabulated, remnant=replace(tabulated.remnant, coefficients=coefficients)),
        )
    )
    assert (less >= more * (1.0 - 1e-9)).all()
    assert (less / more).max() > 1.005
    with pytest.raises(InputError, match="can only be held"):
        design(tabulated, remnant="share")
    louder = deepcopy(fitted)
    louder["recording"]["forcing"]["ft"]["amplitudes"][0] *= 1.2
    with pytest.raises(InputError, match="different forcing functions"):
        read(fitted, louder)
    for part, why in (
        (fitted["recording"], {"forcing": "no sums of sines"}),
        (estimate, {"loops": "--element", "remnant": "--method mle"}),
    ):
        for entry, words in why.items():
            kept = part.pop(entry)
            with pytest.raises(InputError, match=words) as refused:
                read(fitted)
            assert "\n" not in str(refused.value)
            part[entry] = kept


def test_planned_power_is_that_of_simulated_experiments() -> None:
    found = plan(NOMINAL, "tlead", 0.15)
    for subjects, runs in ((8, 5), (20, 2)):
        chance = found.chance(subjects, runs)
        seen = simulated_chance(found, subjects, runs, 4000, np.random.default_rng(subjects))
        assert abs(seen - chance) < 4.0 * np.sqrt(chance * (1.0 - chance) / 4000)
    enough = found.subjects(5)
    assert enough is not None
    assert found.chance(enough, 5) >= 0.8 > found.chance(enough - 1, 5)
    assert found.chance(1, 5) == 0.0
    assert read_effect("tlead +15%") == ("tlead", 0.15)
    assert read_effect("tdvis -5 %") == ("tdvis", -0.05)
    with pytest.raises(InputError, match="tlead \\+15%"):
        read_effect("more lead")


# ------------------------------------------------------------------------------- files


def made() -> Design:
    return pilotid.design("nominal", limit="e=1.5,u=1.5")


def test_signals_for_the_apparatus() -> None:
    found = made()
    table = forcing_table(found, rate=100.0)
    time = table[:, 0]
    assert time[0] == pytest.approx(-8.0)
    assert time[-1] == pytest.approx(PERIOD + 2.0, abs=0.01)
    assert abs(table[[0, -1], 1:]).max() < 1e-12
    inside = (time >= 0.0) & (time < PERIOD)
    assert found.scenario.target is not None
    np.testing.assert_allclose(table[inside, 1], found.scenario.target.at(time[inside]), atol=1e-12)


@pytest.mark.parametrize("run_in", [0.0, 0.5])
def test_signals_for_the_apparatus_never_begin_with_a_step(run_in: float) -> None:
    found = made()
    short = replace(found, scenario=replace(found.scenario, run_in=run_in))
    table, whole = forcing_table(short, rate=100.0), forcing_table(found, rate=100.0)
    assert table[0, 0] == pytest.approx(-2.0)
    assert abs(table[0, 1:]).max() < 1e-12
    np.testing.assert_allclose(table[table[:, 0] >= 0.0], whole[whole[:, 0] >= 0.0], atol=1e-12)
    assert forcing_table(short, fade=0.0)[0, 0] == pytest.approx(-run_in)


def test_wrong_pilots_stay_known() -> None:
    wrong = list(wrong_pilots(made()))
    assert len(wrong) == 14
    assert all(not w.errors or np.isfinite(w.errors).all() for w in wrong)


@pytest.mark.long
def test_the_command_writes_what_others_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "design"
    words = ["design", "single", "--limit", "e=1.5,u=1.5", "--power", "tlead +15%"]
    with pytest.raises(SystemExit) as left:
        main([*words, "--out", str(out)])
    assert left.value.code == 0
    printed = capsys.readouterr().out
    assert "optimality gap" in printed
    assert "Subjects that see it with 80 %" in printed
    held = json.loads((out / "design.json").read_text())
    assert held["gap"] < 0.01
    scenario = scenario_named(str(out / "design.json"))
    assert scenario.name == held["scenario"]["name"]
    again = design(SINGLE_LOOP, limits=Limits(e=1.5, u=1.5))
    assert scenario == again.scenario
    assert pilotid.simulate(scenario, 1).lines["ft"] == again.scenario.target.lines  # type: ignore[union-attr]
    header = (out / "forcing.csv").read_text().splitlines()[0]
    assert header == "t,ft,fd"
    page = (out / "report.html").read_text()
    assert page.count("<svg") == 2
    assert "Another pilot" in page
    assert "with a chance of" in page
    assert "What the design is for" in page
    (out / "design.json").write_text("[]")
    with pytest.raises(InputError, match="cannot be read as a design"):
        scenario_named(str(out / "design.json"))


OWN = """
from dataclasses import replace
from pilotid.datasets import scenario_named
from pilotid.pilot.factors import Delay, Gain, Lead
from pilotid.pilot.model import Channel, PilotModel

FACTORS = Gain("Kvis", 0.3), Lead("tlead"), Delay("tdvis")
MINE = PilotModel("mine", (Channel("visual", "error", 1, FACTORS),))
LOOP = replace(scenario_named("single"), name="loop", model=MINE, truth=(0.3, 1.68, 0.39))
"""


@pytest.mark.long
@pytest.mark.parametrize("through", ["model", "scenario"])
def test_a_model_of_ones_own_reads_back(
    through: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "own.py", tmp_path / "design"
    file.write_text(OWN)
    words = {
        "model": ["single", "--model", f"{file}:MINE", "--truth", "Kvis=0.3"],
        "scenario": [f"{file}:LOOP"],
    }[through]
    for scenario in (words, [str(out / "design.json")]):  # a design of a design too
        with pytest.raises(SystemExit) as left:
            main(["design", *scenario, "--out", str(out)])
        assert left.value.code == 0, capsys.readouterr().err
        found = scenario_named(str(out / "design.json"))
        assert isinstance(found, pilotid.Scenario)
        assert found.model.name == "mine"
        assert found.truth == (0.3, 1.68, 0.39)
    with pytest.raises(SystemExit) as left:
        main(["design", "nominal", "--model", "lead-lag", "--out", str(out)])
    assert left.value.code == 2
    assert "has no value of tlag; say it with --truth" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["--limit", "e=-1"],
        ["--limit", "power=none"],
        ["--wanted", "tdvest=300%"],
        ["--over", "median"],
        ["--power", "tlead"],
        ["--seconds", "100"],
        ["--remnant", "louder"],
        ["--shared"],
        ["--remnant", "share", "--pilots", "2"],
        ["--limit", "e=0.5,u=0.5"],
    ],
)
def test_bad_options_are_refused(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(["design", "nominal", *words, "--out", str(tmp_path)])
    assert left.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
