"""What chance allows: quantiles of the normal and the chi-squared distribution."""

from __future__ import annotations

#: Standard deviations on either side of the mean that hold 95 % of a normal distribution.
Z95 = 1.959963984540054
#: The 95 % quantile of chi-squared with one degree of freedom.
CHI_SQUARED_95 = 3.841458820694124
#: The same with two degrees of freedom.
CHI_SQUARED_95_OF_TWO = 5.991464547107979


def chi_squared_limit(freedom: float, chance: float) -> float:
    """What a chi-squared variable exceeds with a small probability.

    Parameters
    ----------
    freedom
        Degrees of freedom.
    chance
        The probability, for example 0.001.
    """
    from scipy.special import chdtri

    return float(chdtri(freedom, chance))


def chi_squared_tail(freedom: float, value: float) -> float:
    """How often a chi-squared variable exceeds a value.

    Parameters
    ----------
    freedom
        Degrees of freedom.
    value
        The value.
    """
    from scipy.special import chdtrc

    return float(chdtrc(freedom, max(value, 0.0)))
