"""Bayesian posterior of the pilot's parameters under the remnant-aware likelihood.

The likelihood is that of `mle`: prediction errors whitened by a model of the remnant, whose
parameters are sampled along with the pilot's.  The variance of the prediction errors, and
the coefficients of an autoregressive remnant, are integrated out in closed form.  Which
family of remnants it is (low-pass of some order, band-pass, or autoregressive) is decided
once, by the criterion that `mle` uses, and named in the result: the posterior is given it.
Priors are proper and weak, see `pilotid.posterior.likelihood` and docs/theory/posterior.md.

The value of a parameter is its posterior mean on the scale it is sampled on, the logarithm
for positive parameters; standard errors are posterior standard deviations.

Assumes what `mle` assumes.

Use it for the whole distribution: skewed parameters (gain, lead time), and functions of several
parameters, such as phase margins.

Do not use it for a quick look: `mle` gives the same numbers wherever a recording says much, in
less time.  `bayes-white` is there for comparison only.

With ``likelihood="white"`` the residual is taken for white, as in AIAA 2008-7109: its
posterior is far too narrow when the remnant is coloured, and lies in the wrong place.

References: Foreman-Mackey et al., PASP 125, 2013 (emcee); Zellner, An Introduction to
Bayesian Inference in Econometrics, 1971.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from pilotid.estimates.applicability import one_signal
from pilotid.estimates.draws import Draws
from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.warnings import is_vague
from pilotid.pilot.model import PilotModel
from pilotid.posterior.ensembles import DEFAULT_RUN, Chains, Run, ensembles
from pilotid.posterior.importance import Weighted, importance
from pilotid.posterior.likelihood import Marginal, Posterior, Prior, priors_of
from pilotid.recordings.recording import Recording
from pilotid.support.types import FloatArray
from pilotid.time_domain.likelihood import Likelihood
from pilotid.time_domain.output_error import make_estimate, too_short
from pilotid.time_domain.remnant_models import LowPass
from pilotid.time_domain.search import maximise_likelihood
from pilotid.time_domain.settings import LikelihoodSettings

#: Measured on the scenario disturbance-only: samplers that start from different summits end with
#: posteriors that do not agree, each with draws enough.
SUMMITS = (
    "without a target the posterior has several summits, and no sampler here finds them all "
    "reliably; record with a target and a disturbance, or fit one channel"
)


#: Steps of an emcee run, at the most, where it only stands in for importance sampling.
SHORT = 500

Sampler = Literal["auto", "importance", "emcee"]


class Sampled(NamedTuple):
    """Draws, whether there are as many effective ones as asked, and a note for the reader."""

    draws: Draws | None
    converged: bool
    message: str


class Inference(NamedTuple):
    """An estimate, whose draws are those of the posterior under a likelihood."""

    estimate: Estimate
    likelihood: Marginal


@dataclass(frozen=True)
class Bayes(LikelihoodSettings):
    """Posterior of pilot and remnant parameters.

    Attributes
    ----------
    search_band, candidates, refined, band, wide, rounds, noise, loop, weighed
        See `pilotid.time_domain.settings.LikelihoodSettings`.
    likelihood
        ``remnant`` whitens by the remnant's spectrum, ``white`` takes the residual for white.
    sampler
        ``importance``, ``emcee``, or ``auto``: importance sampling, which takes a fraction of
        a second, and emcee where that fails.
    prior
        How much wider the priors of the pilot's parameters are than the default ones.
    priors
        Pairs of a parameter's key and a prior in the place of the default one: any frozen
        distribution of scipy.stats, truncated at the model's bounds.
    intervals
        ``equal-tailed`` or ``highest-density``, the shortest.
    draws, wanted
        Draws of the importance sampler, and how many effective ones it must give.  With 400
        the Monte-Carlo error of the ends of intervals is 0.13 standard errors, which costs
        0.2 % of coverage.
    run
        Length of an emcee run.
    """

    likelihood: Literal["remnant", "white"] = "remnant"
    sampler: Sampler = "auto"
    prior: float = 1.0
    priors: tuple[tuple[str, Prior], ...] = ()
    intervals: Literal["equal-tailed", "highest-density"] = "equal-tailed"
    draws: int = 4000
    wanted: float = 400.0
    run: Run = DEFAULT_RUN

    @property
    def name(self) -> str:
        """``bayes``, or ``bayes-white`` for a white likelihood."""
        return "bayes" if self.likelihood == "remnant" else "bayes-white"

    @property
    def libraries(self) -> tuple[str, ...]:
        """``emcee`` where it is asked for; importance sampling does without."""
        return ("emcee",) if self.sampler == "emcee" else ()

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """None: any recording and any model will do."""
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Sample the posterior.

        Parameters
        ----------
        recording
            The recording; all its runs share the pilot.
        model
            The pilot model, whose start is one of the starts of the search for the mode.
        rng
            Draws the other starts, and the posterior's draws.
        """
        return self.infer(recording, model, rng).estimate

    def infer(
        self,
        recording: Recording,
        model: PilotModel,
        rng: np.random.Generator,
        watch: Callable[[float], None] | None = None,
    ) -> Inference:
        """As `fit`, and the likelihood too, which a posterior predictive band needs.

        Parameters
        ----------
        recording, model, rng
            As for `fit`.
        watch
            Is told the share of an emcee run that is done.
        """
        white = self.likelihood == "white"
        settings = replace(self, noise=LowPass(0), loop=False) if white else self
        found = maximise_likelihood(recording, model, rng, settings)
        joint = found.joint
        likelihood = Marginal(joint, 1.0 if white else found.variance_factor)
        posterior = Posterior(likelihood, priors_of(model, joint.noise, self.priors, self.prior))
        sampled = self._sampled(posterior, posterior.approximation(found), rng, watch)
        draws = sampled.draws
        if draws is None:
            nothing = failed(self.name, model, Outcome.NOT_CONVERGED, sampled.message)
            return Inference(nothing, likelihood)
        pilot = joint.pilot
        values = draws.centre[:pilot]
        highest = self.intervals == "highest-density"
        intervals = draws.highest_density if highest else draws.equal_tailed
        estimate = make_estimate(
            self.name,
            recording,
            model,
            values,
            draws.covariance[:pilot, :pilot],
            converged=sampled.converged,
            optimum=found.end.values[0, :pilot],
        )
        words = (estimate.message, sampled.message)
        estimate = replace(
            estimate,
            intervals=intervals[:pilot],
            message="; ".join(part for part in words if part),
            iterations=found.iterations,
            starts=found.starts,
            band=found.band_of(recording),
            remnant=found.remnant,
            draws=draws,
            remarks=too_short(Likelihood(joint.prediction), values) if white else (),
        )
        if estimate.outcome.usable and is_vague(estimate) and one_signal(recording, model):
            # Several summits, far apart: draws about one of them look as good as any others.
            estimate = replace(estimate, outcome=Outcome.NOT_CONVERGED, message=SUMMITS)
        return Inference(estimate, likelihood)

    def _sampled(
        self,
        posterior: Posterior,
        start: tuple[FloatArray, FloatArray],
        rng: np.random.Generator,
        watch: Callable[[float], None] | None,
    ) -> Sampled:
        """Draws by the sampler asked for, which begins at a mode with a covariance."""
        run, message = self.run, ""
        if self.sampler != "emcee":
            weighted = importance(
                posterior.log_density, *start, rng, count=self.draws, wanted=self.wanted
            )
            enough = weighted.effective >= self.wanted
            few = f"importance sampling gave {weighted.effective:.0f} effective draws only"
            if enough or self.sampler == "importance":
                return Sampled(_weighted(posterior, weighted), enough, "" if enough else few)
            message = f"{few}, so emcee took over"
            start = weighted.moments(*start)
            run = replace(run, effective=self.wanted, most=min(run.most, SHORT))
        chains = ensembles(posterior.log_density, *start, rng, run, watch)
        if chains is None:
            return Sampled(None, False, "the posterior density is zero around the best fit")
        if not chains.converged:
            message = (
                f"after {chains.steps} steps the ensembles have {np.min(chains.effective):.0f} "
                f"effective draws, of {run.effective:.0f} wanted, and R-hat "
                f"{np.max(chains.r_hat):.3f}"
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
