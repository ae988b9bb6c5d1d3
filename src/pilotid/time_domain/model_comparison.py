"""Likelihoods of several models of one recording, scored on the same samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.likelihood import Likelihood
from pilotid.recordings.recording import Recording
from pilotid.time_domain.maximum_likelihood import likelihood_from
from pilotid.time_domain.prepare import decimation
from pilotid.time_domain.settings import LikelihoodSettings


def likelihoods_on_the_same_samples(
    recording: Recording, estimates: Sequence[Estimate], settings: LikelihoodSettings
) -> list[Likelihood | None]:
    """The likelihood of each model, in the widest band that one of the estimates took.

    Estimates of `mle` choose band and nuisance terms by themselves, and channels on derivatives
    cost samples at both ends; criteria of likelihoods that differ in that do not compare.  Here
    each is maximised anew from its estimate, on samples that suit all, with the same nuisance
    terms: an offset, and the free decays of all models.  A likelihood is that of the optimum next
    to the estimate: where the fit itself ended in a wrong one, so does this.

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
    return [
        None if e.likelihood is None else likelihood_from(recording, e.model, same, e.values, terms)
        for e in estimates
    ]
