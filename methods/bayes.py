"""Bayesian posterior of the pilot's parameters under the remnant-aware likelihood.

The likelihood is that of `mle`: prediction errors whitened by a model of the remnant, whose
parameters are sampled along with the pilot's.  The variance of the prediction errors, and
the coefficients of an autoregressive remnant, are integrated out in closed form.  Which
family of remnants it is (low-pass of some order, band-pass, or autoregressive) is decided
once, by the criterion that `mle` uses, and named in the result: the posterior is given it.
Priors are proper and weak, see `pilotid.likelihood.posterior` and docs/theory/posterior.md.

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

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.warnings import is_vague, one_signal
from pilotid.likelihood.diagnostics import NO_PILOT, fit_remarks, with_verdict
from pilotid.likelihood.estimates import make_estimate, too_short
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.posterior import Posterior, Prior, priors_of, sample
from pilotid.likelihood.remnant_models import LowPass
from pilotid.likelihood.search import LikelihoodSettings, maximise_likelihood
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording

#: Measured on the scenario disturbance-only: samplers that start from different summits end with
#: posteriors that do not agree, each with draws enough.
SUMMITS = (
    "without a target the posterior has several summits, and no sampler here finds them all "
    "reliably; record with a target and a disturbance, or fit one channel"
)


@dataclass(frozen=True)
class Bayes(LikelihoodSettings):
    """Posterior of pilot and remnant parameters.

    Attributes
    ----------
    band, wide, noise, loop, weighed
        See `pilotid.likelihood.search.LikelihoodSettings`.
    likelihood
        ``remnant`` whitens by the remnant's spectrum, ``white`` takes the residual for white.
    prior
        How much wider the priors of the pilot's parameters are than the default ones.
    priors
        Pairs of a parameter's key and a prior in the place of the default one: any frozen
        distribution of scipy.stats, truncated at the model's bounds.
    effective
        Effective number of draws that every parameter must have.  With 400 the Monte-Carlo error
        of the ends of intervals is 0.13 standard errors, which costs 0.2 % of coverage.
    most
        Steps of each ensemble of walkers at the most.
    """

    likelihood: Literal["remnant", "white"] = "remnant"
    prior: float = 1.0
    priors: tuple[tuple[str, Prior], ...] = ()
    effective: float = 400.0
    most: int = 1500

    libraries: ClassVar[tuple[str, ...]] = ("emcee",)

    @property
    def name(self) -> str:
        """``bayes``, or ``bayes-white`` for a white likelihood."""
        return "bayes" if self.likelihood == "remnant" else "bayes-white"

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
        white = self.likelihood == "white"
        settings = replace(self, noise=LowPass(0), loop=False) if white else self
        optimum = maximise_likelihood(recording, model, rng, settings)
        if optimum.rank == 0:  # nobody wants draws about what is no pilot
            return failed(self.name, model, Outcome.CONTRADICTED, NO_PILOT)
        joint = optimum.joint
        priors = priors_of(model, joint.noise, self.priors, self.prior)
        posterior = Posterior(joint, priors, 1.0 if white else optimum.variance_factor)
        start = posterior.approximation(optimum)
        draws = sample(posterior, *start, rng, self.effective, self.most)
        if draws is None:
            why = "the posterior density is zero around the best fit"
            return failed(self.name, model, Outcome.NOT_CONVERGED, why)
        message = (
            f"after {draws.chains[1]} steps the ensembles have {draws.effective.min():.0f} "
            f"effective draws, of {self.effective:.0f} wanted, and R-hat {draws.r_hat.max():.3f}"
        )
        pilot = joint.pilot_count
        values = draws.centre[:pilot]
        estimate = make_estimate(
            self.name,
            recording,
            model,
            values,
            draws.covariance[:pilot, :pilot],
            converged=draws.converged,
            optimum=optimum.end.values[0, :pilot],
        )
        words = (estimate.message, "" if draws.converged else message)
        estimate = replace(
            estimate,
            intervals=draws.equal_tailed[:pilot],
            message="; ".join(part for part in words if part),
            draws=draws,
        )
        # The likelihood is that of `mle`: the same speaks against it.
        if white:
            tested, remarks = None, too_short(Likelihood(joint.prediction), values)
        else:
            tested = optimum.covariance
            remarks = fit_remarks(optimum, recording, asked_for_band=self.loop)
        estimate = with_verdict(estimate, optimum, recording, tested, remarks)
        if estimate.outcome.usable and is_vague(estimate) and one_signal(recording, model):
            # Several summits, far apart: draws about one of them look as good as any others.
            estimate = replace(estimate, outcome=Outcome.NOT_CONVERGED, message=SUMMITS)
        return estimate
