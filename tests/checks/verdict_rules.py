"""How often do the rules of a report call a right method wrong, and what do they overlook?

    nox -s check -- verdicts     20 minutes

Whole reports of right methods are simulated: as many scenarios and methods as there are, 7
parameters.  The
methods of a scenario share its recordings, so that their errors are correlated (.9); gain and
lead have lognormal errors, as estimates of Kvis and tlead do, the others normal ones; the
intervals hold the truth in 95 %.  Means are the truth, or each is as far off as a bias may be
that does not matter: the rules' hardest case.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from pilotid.chance import Z95
from pilotid.datasets import SCENARIOS
from pilotid.methods import METHODS
from pilotid.report.rules import BIAS_BOUNDS, BIAS_PERCENT, ENOUGH, Rules, matters
from pilotid.study.entries import ParameterTruth
from pilotid.study.score import Score, scored
from pilotid.types import FloatArray

#: Share of a method's errors that the recordings make, and with it every other method's.
SHARED = 0.9
#: Standard deviations, relative to the truth, and whether errors are lognormal; about those of
#: the bound of `nominal`.
KINDS = (
    ("Kvis", 0.28, True),
    ("tlead", 0.28, True),
    ("tdvis", 0.011, False),
    ("Kvest", 0.046, False),
    ("tdvest", 0.012, False),
    ("fnm", 0.012, False),
    ("dnm", 0.042, False),
)


def numbers(spread: float, skewed: bool, drawn: FloatArray, bias: float = 0.0) -> FloatArray:
    """Values, claimed errors and intervals of a right method for a truth of 1.

    Parameters
    ----------
    spread
        Standard deviation of the values, of their logarithms if they are skewed.
    skewed
        Whether errors are lognormal.
    drawn
        Standard normal numbers, shape (fits,).
    bias
        Added to all values but not to intervals, in units of the bound.
    """
    claimed = np.full(drawn.shape, spread)
    if skewed:
        values = np.exp(spread * drawn - 0.5 * spread**2)  # whose mean is 1
        low, high = (values * np.exp(0.5 * spread**2 + z * spread) for z in (-Z95, Z95))
    else:
        values = 1.0 + spread * drawn
        low, high = values - Z95 * spread, values + Z95 * spread
    columns = np.column_stack([values, claimed, low, high])
    columns[:, 0] += bias * bound_of(spread, skewed)
    return columns


def bound_of(spread: float, skewed: bool) -> float:
    """The bound, which right methods reach: the standard deviation of the values."""
    return math.sqrt(math.expm1(spread**2)) if skewed else spread


def score(key: str, spread: float, skewed: bool, drawn: FloatArray, bias: float = 0.0) -> Score:
    """A parameter's scores in %, see `numbers`."""
    known = ParameterTruth(key, "", 1.0, bound_of(spread, skewed))
    given = numbers(spread, skewed, drawn, bias)
    return scored(known, given, np.ones(drawn.size, dtype=bool), drawn.size).percent


def report(
    rng: np.random.Generator, recordings: int, scenarios: int, methods: int, *, off: bool = False
) -> Iterator[Score]:
    """All scores of a report of right methods, whose biases nearly matter if they are `off`."""
    for _ in range(scenarios):
        of_recordings = rng.standard_normal((len(KINDS), recordings))
        of_recordings[1] = -0.99 * of_recordings[0] + math.sqrt(1 - 0.99**2) * of_recordings[1]
        for _ in range(methods):
            own = rng.standard_normal(of_recordings.shape)
            drawn = math.sqrt(SHARED) * of_recordings + math.sqrt(1.0 - SHARED) * own
            for (key, spread, skewed), row in zip(KINDS, drawn, strict=True):
                most = max(BIAS_BOUNDS, 0.01 * BIAS_PERCENT / bound_of(spread, skewed))
                bias = rng.choice([-most, most]) if off else 0.0
                yield score(key, spread, skewed, row, bias)


def called(
    seed: int,
    reports: int,
    recordings: int,
    scenarios: int = len(SCENARIOS),
    methods: int = len(METHODS),
    *,
    off: bool = False,
) -> dict[str, int]:
    """In how many reports any right method is called biased, narrow, or either.

    ``three errors`` counts what a rule that does not allow for the number of comparisons would
    call biased: more than three standard errors, 1 % and a quarter of the bound.
    """
    rules = Rules(2 * scenarios * methods * len(KINDS))
    counts = {"biased": 0, "narrow": 0, "either": 0, "three errors": 0}
    for rng in np.random.default_rng(seed).spawn(reports):
        found = list(report(rng, recordings, scenarios, methods, off=off))
        biased, narrow = any(map(rules.biased, found)), any(map(rules.narrow, found))
        three = any(abs(s.bias) > max(3.0 * s.bias_se, matters(s)) for s in found)
        for name, any_of_it in zip(counts, (biased, narrow, biased or narrow, three), strict=True):
            counts[name] += any_of_it
    return counts


def seen(seed: int, recordings: int, kind: tuple[str, float, bool], bias: float) -> list[float]:
    """Shares of 2000 cells of a whole report in which one parameter is biased, settled or open."""
    rules = Rules(2 * len(SCENARIOS) * len(METHODS) * len(KINDS))
    rng = np.random.default_rng(seed)
    ends = {"biased": 0, "settled": 0, "open": 0}
    for _ in range(2000):
        found = score(*kind, rng.standard_normal(recordings), bias)
        settled = "open" if rules.needed(found) else "settled"
        ends["biased" if rules.biased(found) else settled] += 1
    return [count / 2000 for count in ends.values()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reports", type=int, default=400)
    settings = parser.parse_args()
    for recordings, off in product((50, 200), (False, True)):
        counts = called(1, settings.reports, recordings, off=off)
        parts = []
        for name, count in counts.items():
            share = count / settings.reports
            error = math.sqrt(share * (1.0 - share) / settings.reports)
            parts.append(f"{name} {count} ({100 * share:.1f} ± {100 * error:.1f} %)")
        means = "biases that nearly matter" if off else "no bias"
        print(f"{recordings} recordings, {means}: of {settings.reports} reports any is called "
              f"{', '.join(parts)}", flush=True)  # fmt: skip
    print("\n| bias / bound | parameter | recordings | called biased | good | open |")
    print("| --- | --- | --- | --- | --- | --- |")
    for bias in (0.0, 0.25, 0.5, 1.0):
        for kind in (KINDS[0], KINDS[3]):
            for recordings in (ENOUGH, 25, 50, 100, 200, 500, 1000):
                shares = " | ".join(f"{s:.2f}" for s in seen(2, recordings, kind, bias))
                print(f"| {bias:g} | {kind[0]} | {recordings} | {shares} |", flush=True)


if __name__ == "__main__":
    main()
