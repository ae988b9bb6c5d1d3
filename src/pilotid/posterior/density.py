"""The posterior density of pilot and remnant parameters, on the scale it is sampled on.

Positive parameters are sampled by their logarithm: gain and lead time, of which only the
product is well known, then lie along a straight line instead of a hyperbola.
"""

from __future__ import annotations

import numpy as np

from pilotid.posterior.likelihood import Likelihood
from pilotid.posterior.priors import Prior
from pilotid.solve.scale import Scale
from pilotid.time_domain.maximum_likelihood import Maximum
from pilotid.types import FloatArray

#: Standard deviations, on the inner scale, beyond which nobody looks for a parameter: they
#: keep the first guess of the covariance finite where the likelihood knows nothing.
BROAD_LOG, BROAD_LINEAR = 2.0, 0.5


class Posterior:
    """Log-density by points on the inner scale.

    Parameters
    ----------
    likelihood
        The likelihood.
    priors
        One for each of its parameters; the bounds truncate them.
    """

    def __init__(self, likelihood: Likelihood, priors: tuple[Prior, ...]) -> None:
        self.likelihood, self.priors = likelihood, priors
        self._scale = Scale(likelihood.positive)
        self._lower, self._upper = likelihood.lower, likelihood.upper

    def values(self, points: FloatArray) -> FloatArray:
        """Parameters at points of the inner scale, shape (sets, parameters)."""
        return self._scale.leave(points)

    def points(self, values: FloatArray) -> FloatArray:
        """Points of the inner scale, shape (sets, parameters)."""
        return self._scale.enter(values)

    def log_prior(self, values: FloatArray) -> FloatArray:
        """Logarithm of the prior density at parameters inside the bounds, shape (sets,)."""
        columns = zip(self.priors, values.T, strict=True)
        return np.asarray(np.sum([prior.logpdf(column) for prior, column in columns], axis=0))

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant, -inf outside the bounds and where there is no number, (sets,)."""
        with np.errstate(over="ignore"):
            values = self.values(points)
        inside = np.all((values > self._lower) & (values < self._upper), axis=1)
        result = np.full(len(points), -np.inf)
        if inside.any():
            own = values[inside]
            # d value / d log(value) = value
            slope = np.sum(points[inside][:, self._scale.positive], axis=1)
            result[inside] = self.likelihood.log(own) + self.log_prior(own) + slope
        return np.where(np.isfinite(result), result, -np.inf)

    def approximation(self, maximum: Maximum) -> tuple[FloatArray, FloatArray]:
        """Mode of the likelihood and covariance there, on the inner scale.

        Parameters
        ----------
        maximum
            The likelihood's maximum, all of the remnant's parameters included.
        """
        joint, end = maximum.joint, maximum.end
        scale = Scale(joint.positive)
        values = end.values[:1]
        variance = max(float(end.cost[0]), np.finfo(float).tiny) / joint.residuals
        information = scale.inner(end.gram[:1], values)[0, :-1, :-1] / variance
        broad = np.where(joint.positive, BROAD_LOG, BROAD_LINEAR) ** -2.0
        covariance = np.linalg.inv(information + np.diag(broad))
        count = self.likelihood.count
        return scale.enter(values)[0, :count], np.asarray(covariance[:count, :count])
