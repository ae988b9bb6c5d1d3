"""What chance allows: quantiles of the normal and the chi-squared distribution."""

from __future__ import annotations

#: Standard deviations on either side of the mean that hold 95 % of a normal distribution.
Z95 = 1.959963984540054
#: Normal quantiles of one in 1000 and one in 10,000.
ONE_IN_1000, ONE_IN_10000 = 3.09, 3.719


def chi_squared_quantile(freedom: float, normal: float) -> float:
    """Quantile of chi-squared (Wilson and Hilferty's approximation).

    Parameters
    ----------
    freedom
        Degrees of freedom.
    normal
        The same quantile of the standard normal distribution.
    """
    share = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - share + normal * share**0.5) ** 3)
