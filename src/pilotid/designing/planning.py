"""How many subjects, runs and seconds it takes to see a difference between two conditions.

Every subject flies both conditions; the test is the paired t test of the subjects'
differences.  A subject's estimate errs by the bound of its runs together, by what differs
from run to run, and the true difference varies between subjects; the chance to find it is
that of a noncentral t distribution (Cohen, Statistical Power Analysis, 1988).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.simulation import require_stable
from pilotid.designing.lines import loop_of, powers_of, reference_lines, widening, with_held_remnant
from pilotid.types import InputError

LEVEL = 0.05  # of the two-sided test
WANTED = 0.8  # chance to see the difference
MOST = 200  # subjects that are looked at
RUNS = (1, 2, 3, 5, 8)
PAIRS = (2, 4, 6, 8, 10)  # where the disturbance alternates between runs
WINDOWS = (0.5, 1.0, 2.0)  # in multiples of the design's


@dataclass(frozen=True)
class Plan:
    """A difference to be seen, and what hides it.

    All are shares of the parameter's value in the first condition.

    Attributes
    ----------
    key, effect
        The parameter, and its difference between the conditions.
    error
        Standard error of the difference that one run in each condition leaves, by the bound.
    between
        Standard deviation of the true difference between subjects.
    within
        Standard deviation of the parameter from run to run.
    window
        Length of a run [s] that `error` belongs to.
    choices
        Numbers of runs in each condition that the table has.
    """

    key: str
    effect: float
    error: float
    between: float
    within: float
    window: float
    choices: tuple[int, ...] = RUNS

    def deviation(self, runs: int, times: float = 1.0) -> float:
        """Standard deviation of a subject's estimated difference.

        Parameters
        ----------
        runs
            Runs in each condition, fitted jointly.
        times
            Length of a run in multiples of `window`.
        """
        widened = widening(runs, times * self.window)
        per_run = widened * self.error**2 / times + 2.0 * self.within**2
        return math.sqrt(self.between**2 + per_run / runs)

    def chance(self, subjects: int, runs: int, times: float = 1.0) -> float:
        """Chance that the test finds the difference, 0 for fewer than two subjects.

        Parameters
        ----------
        subjects, runs
            Subjects, and runs of each in each condition.
        times
            Length of a run in multiples of `window`.
        """
        from statsmodels.stats.power import TTestPower

        if subjects < 2:
            return 0.0
        effect = abs(self.effect) / self.deviation(runs, times)
        return float(TTestPower().power(effect, subjects, LEVEL))

    def subjects(self, runs: int, times: float = 1.0, wanted: float = WANTED) -> int | None:
        """Fewest subjects with whom the chance is as wanted; None for more than `MOST`.

        Parameters
        ----------
        runs, times
            See `chance`.
        wanted
            The chance, from 0 to 1.
        """
        return next((n for n in range(2, MOST + 1) if self.chance(n, runs, times) >= wanted), None)

    def table(self) -> Iterator[tuple[float, list[int | None]]]:
        """Length of a run [s], and the subjects that suffice for each of `choices`."""
        for times in WINDOWS:
            yield times * self.window, [self.subjects(runs, times) for runs in self.choices]


def read_effect(text: str) -> tuple[str, float]:
    """The parameter and the share of a text such as ``tlead +15%``."""
    found = re.fullmatch(r"\s*(\w+)\s*[ =]?\s*([+-]?\d+(?:\.\d+)?)\s*%\s*", text)
    if found is None or float(found[2]) == 0.0:
        raise InputError(f"--power {text}: must be a parameter and its change, as in 'tlead +15%'")
    return found[1], float(found[2]) / 100.0


def plan(
    scenario: Scenario, key: str, effect: float, *, between: float = 0.1, within: float = 0.05
) -> Plan:
    """A plan for a difference between the scenario's pilot and one who differs in a parameter.

    Parameters
    ----------
    scenario
        The experiment; how many runs it has does not count.
    key, effect
        The parameter, and the share by which it differs.
    between, within
        See `Plan`.

    Raises
    ------
    InputError
        If there is no such parameter, or the other pilot's loop is unstable.
    """
    if key not in scenario.model.keys:
        raise InputError(
            f"--power: model {scenario.model.name} has no parameter {key}: choose from "
            f"{', '.join(scenario.model.keys)}"
        )
    runs = 2 if scenario.alternating else 1
    first = with_held_remnant(replace(scenario, runs=runs))
    truth = dict(zip(first.model.keys, first.truth, strict=True))
    truth[key] *= 1.0 + effect
    second = replace(first, truth=tuple(truth.values()))
    require_stable(second)
    i = first.model.keys.index(key)
    lines, powers = reference_lines(first), powers_of(first)
    one, other = (float(loop_of(s, lines).errors(powers)[i]) for s in (first, second))
    error = math.sqrt(runs) * math.hypot(one, other * (1.0 + effect))
    choices = PAIRS if scenario.alternating else RUNS
    return Plan(key, effect, error, between, within, first.duration, choices)
