"""Likelihoods of several models of one recording, scored on the same samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.likelihood import Likelihood
from pilotid.recordings.recording import Recording
from pilotid.time_domain.maximum_likelihood import Maximum, maximum_from
from pilotid.time_domain.prepare import decimation
from pilotid.time_domain.settings import LikelihoodSettings


def likelihoods_on_the_same_samples(
    recording: Recording, estimates: Sequence[Estimate], settings: LikelihoodSettings
) -> list[Likelihood | None]:
    """The likelihood of each model, in the widest band that one of the estimates took.

    Estimates of `mle` choose band and nuisance terms by themselves, and channels on derivatives
    cost samples at both ends; criteria of likelihoods that differ in that do not compare.  Here
    each is maximised anew from its estimate, on samples that suit all, with the same nuisance
    terms: an offset, and the free decays of all models.  A second start has what the most likely
    of them says of the parameters that they share: an estimate may be that of a wrong optimum.

    Parameters
    ----------
    recording
        The recording.
    estimates
        Of different models, by maximum likelihood.
    settings
        Those of the estimates, such as ``MLE()``.

    Returns
    -------
    One likelihood for each estimate, None for an estimate without one.
    """
    intervals = [e.likelihood.dt for e in estimates if e.likelihood is not None]
    if not intervals:
        return [None] * len(estimates)
    usual = decimation(recording.dt, settings.band) * recording.dt
    finest = min(intervals)
    narrow = math.isclose(finest, usual) or settings.wide is None
    same = replace(
        settings,
        band=settings.band if narrow else settings.wide,
        wide=None,
        derivatives=max(c.derivative for e in estimates for c in e.model.channels),
    )
    terms = (0.0, *sorted({pole for e in estimates for pole in e.model.fixed_poles}))
    known = [e for e in estimates if e.likelihood is not None]
    found = [maximum_from(recording, e.model, same, e.values, terms) for e in known]
    trusted = [i for i, e in enumerate(known) if e.outcome.usable] or range(len(known))
    best = max(trusted, key=lambda i: found[i].likelihood.logarithm)
    shared = dict(zip(known[best].model.keys, _pilot(found[best]), strict=True))
    for i, estimate in enumerate(known):
        if i != best:
            own = dict(zip(estimate.model.keys, estimate.values.tolist(), strict=True))
            start = estimate.model.vector({key: shared.get(key, own[key]) for key in own})
            other = maximum_from(recording, estimate.model, same, start, terms)
            found[i] = max(found[i], other, key=lambda m: m.likelihood.logarithm)
    likelihoods = iter(found)
    return [None if e.likelihood is None else next(likelihoods).likelihood for e in estimates]


def _pilot(maximum: Maximum) -> list[float]:
    """The pilot's parameters at an optimum."""
    values: list[float] = maximum.end.values[0, : maximum.joint.pilot].tolist()
    return values
