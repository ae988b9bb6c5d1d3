"""Draws of a posterior by the sampler asked for, and whether there are enough of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from pilotid.estimates.draws import Draws
from pilotid.posterior.ensembles import Chains, Run, ensembles
from pilotid.posterior.importance import Weighted, importance
from pilotid.posterior.likelihood import Posterior
from pilotid.time_domain.maximum_likelihood import Maximum

#: Steps of an emcee run, at the most, where it only stands in for importance sampling.
SHORT = 500

Sampler = Literal["auto", "importance", "emcee"]


class Sampled(NamedTuple):
    """Draws, whether there are as many effective ones as asked, and a note for the reader."""

    draws: Draws | None
    converged: bool
    message: str


def sample(
    posterior: Posterior,
    maximum: Maximum,
    rng: np.random.Generator,
    *,
    sampler: Sampler,
    count: int,
    wanted: float,
    run: Run,
    watch: Callable[[float], None] | None = None,
) -> Sampled:
    """Draws of a posterior.

    Parameters
    ----------
    posterior, maximum
        The density, and the optimum around which it lies.
    rng
        Every random number comes from it.
    sampler
        ``importance``, ``emcee``, or ``auto``: importance sampling, and emcee where that
        gives too few effective draws.
    count, wanted
        Draws of the importance sampler, and how many effective ones it must give.
    run
        Length of an emcee run.
    watch
        Told the share of an emcee run that is done.
    """
    start = posterior.approximation(maximum)
    message = ""
    if sampler != "emcee":
        weighted = importance(posterior.log_density, *start, rng, count=count, wanted=wanted)
        few = f"importance sampling gave {weighted.effective:.0f} effective draws only"
        if weighted.effective >= wanted or sampler == "importance":
            good = weighted.effective >= wanted
            return Sampled(_weighted(posterior, weighted), good, "" if good else few)
        message = f"{few}, so emcee took over"
        start = weighted.moments(*start)
        run = replace(run, effective=wanted, most=min(run.most, SHORT))
    chains = ensembles(posterior.log_density, *start, rng, run, watch)
    if chains is None:
        return Sampled(None, False, "the posterior density is zero around the best fit")
    if not chains.converged:
        message = (
            f"after {chains.steps} steps the ensembles have {np.min(chains.effective):.0f} "
            f"effective draws, of {run.effective:.0f} wanted, and R-hat {np.max(chains.r_hat):.3f}"
        )
    return Sampled(_drawn(posterior, chains), chains.converged, message)


def _weighted(posterior: Posterior, weighted: Weighted) -> Draws:
    # Points outside the bounds may be beyond what numbers can hold; they have no weight.
    inside = weighted.weights > 0.0
    values = posterior.values(weighted.points[inside])
    parameters = values.shape[1]
    return Draws(
        "importance",
        posterior.likelihood.keys,
        posterior.likelihood.positive,
        values,
        weighted.log_density[inside],
        weighted.weights[inside],
        chains=(1, len(values), 1),
        effective=np.full(parameters, weighted.effective),
        r_hat=np.full(parameters, np.nan),
        autocorrelation=np.ones(parameters),
    )


def _drawn(posterior: Posterior, chains: Chains) -> Draws:
    count, steps, walkers, parameters = chains.points.shape
    values = posterior.values(chains.points.reshape(-1, parameters))
    return Draws(
        "emcee",
        posterior.likelihood.keys,
        posterior.likelihood.positive,
        values,
        chains.log_density.ravel(),
        np.full(len(values), 1.0 / len(values)),
        chains=(count, steps, walkers),
        effective=chains.effective,
        r_hat=chains.r_hat,
        autocorrelation=chains.autocorrelation,
        acceptance=chains.acceptance,
    )
