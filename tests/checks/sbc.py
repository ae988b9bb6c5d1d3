"""Simulation-based calibration of `bayes` (Talts et al. 2018): are its posteriors honest?

    nox -s check -- sbc --draws 300

Pilot and remnant are drawn from a prior, a recording is simulated, and the posterior under
the same prior computed.  The rank of each true parameter among its posterior draws is then
uniform, whatever the prior, if likelihood, priors and sampler are right.  The prior is a
narrow one around the pilot of `nominal`, so that nearly all closed loops are stable; the few
that are not are drawn again, which the posterior knows nothing of.  The remnant's order is
given, as theory asks; frequency and damping are drawn and sampled.

Exit status 1 if a chi-squared test rejects the uniformity of a parameter's ranks at 1 %.
Writes docs/sbc.svg, the histograms.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.estimate.method import identify
from pilotid.likelihood.posterior import LogNormal
from pilotid.likelihood.remnant_models import LowPass
from pilotid.methods.bayes import Bayes
from pilotid.model.loops import is_stable
from pilotid.support.numbers import fit_rng, recording_rng
from pilotid.support.types import FloatArray

NOMINAL = SCENARIOS["nominal"]
SPREAD = 0.15  # of the pilot's parameters, on the logarithmic scale
TRUTH = dict(zip(NOMINAL.model.keys, NOMINAL.truth, strict=True))
PILOT = {key: LogNormal(value, SPREAD) for key, value in TRUTH.items()}
REMNANT = {"frequency": LogNormal(3.5, 0.3), "damping": LogNormal(0.7, 0.2)}
PRIORS = PILOT | REMNANT
BINS = 12  # 25 of 300 ranks in each
DOCS = Path(__file__).parents[2] / "docs"


def drawn(rng: np.random.Generator) -> Scenario:
    """A scenario from the prior whose closed loop is stable."""
    while True:
        values = [p.median * np.exp(p.spread * rng.standard_normal()) for p in PRIORS.values()]
        *pilot, frequency, damping = map(float, values)
        remnant = replace(NOMINAL.remnant, frequency=frequency, damping=damping)
        scenario = replace(NOMINAL, truth=tuple(pilot), remnant=remnant)
        if is_stable(scenario.model, scenario.values, scenario.element):
            return scenario


def ranks(number: int, seed: int) -> tuple[FloatArray, str]:
    """Share of the posterior below the truth for each parameter, and why there is none."""
    rng = recording_rng(seed, "sbc", number)
    scenario = drawn(rng)
    recording = simulate(scenario, rng)
    method = Bayes(priors=tuple(PRIORS.items()), noise=LowPass(NOMINAL.remnant.order))
    estimate = identify(method, recording, scenario.model, fit_rng(seed, "bayes", "sbc", number))
    draws = estimate.draws
    if draws is None or not estimate.outcome.usable:
        return np.full(len(PRIORS), np.nan), estimate.sentence
    remnant = scenario.remnant
    truth = np.array([*scenario.truth, remnant.frequency, remnant.damping])
    return np.mean(draws.values < truth, axis=0), ""


def probability(shares: FloatArray) -> float:
    """Of a chi-squared as large as that of the histogram, if ranks are uniform."""
    from scipy.special import chdtrc

    counts, _ = np.histogram(shares, bins=BINS, range=(0.0, 1.0))
    expected = shares.size / BINS
    return float(chdtrc(BINS - 1, np.sum((counts - expected) ** 2) / expected))


def figure(shares: FloatArray, file: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "pilotid"  # the same bytes each time
    import matplotlib.pyplot as plt

    count = len(shares)
    deviation = np.sqrt(count / BINS * (1.0 - 1.0 / BINS))
    picture, panels = plt.subplots(3, 3, figsize=(9.0, 5.4), sharey=True, layout="constrained")
    for axes, key, own in zip(panels.flat, PRIORS, shares.T, strict=True):
        low, high = count / BINS + np.array([-1.0, 1.0]) * 2.576 * deviation
        for limit in (low, high):
            axes.axhline(limit, color="#444444", linestyle="--", linewidth=0.8)
        axes.hist(own, bins=BINS, range=(0.0, 1.0), color="#332288", alpha=0.6, rwidth=0.92)
        axes.set_title(f"{key}   p = {probability(own):.2f}", fontsize=9)
        axes.set_xlim(0.0, 1.0)
        axes.tick_params(labelsize=7)
    picture.supxlabel("rank of the truth among posterior draws", fontsize=9)
    picture.supylabel("recordings", fontsize=9)
    picture.savefig(file, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        jobs = (range(given.draws), [given.seed] * given.draws)
        found = list(pool.map(ranks, *jobs, chunksize=5))
    shares = np.array([share for share, _ in found])
    usable = np.isfinite(shares).all(axis=1)
    print(f"{usable.sum()} of {len(found)} posteriors used", *{why for _, why in found if why})
    print("parameter    chi-squared p   mean rank")
    good = bool(usable.all())
    for key, own in zip(PRIORS, shares[usable].T, strict=True):
        p = probability(own)
        good &= p >= 0.01
        print(f"{key:12} {p:13.3f} {own.mean():11.3f}{'' if p >= 0.01 else '  rejected'}")
    figure(shares[usable], DOCS / "sbc.svg")
    print(f"written: {DOCS / 'sbc.svg'}")
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
