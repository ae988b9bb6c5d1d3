"""Settings that methods of maximum likelihood share."""

from __future__ import annotations

from dataclasses import dataclass

from pilotid.time_domain.remnant_models import NoiseModel


@dataclass(frozen=True)
class SearchSettings:
    """How the optimum is searched.

    Attributes
    ----------
    search_band
        Narrow and cheap band in which the optimum is searched [rad/s].
    candidates, refined
        Random starts screened, and starts minimised, see `pilotid.solve.search.search`.
    """

    search_band: float = 26.0
    candidates: int = 6
    refined: int = 2


@dataclass(frozen=True)
class LikelihoodSettings(SearchSettings):
    """How the likelihood of pilot and remnant is maximised.

    Attributes
    ----------
    search_band, candidates, refined
        See `SearchSettings`.
    band
        Analysis band [rad/s]; None uses the full sampling rate.
    wide
        Bands that take its place, one after the other, while the recording tells of the pilot
        near the edge of the one before; empty for none.
    rounds
        How often the remnant's model is chosen anew at most.
    noise
        The remnant's model, where it is not to be chosen.
    loop
        Whether the likelihood is that of the band, which needs the controlled element, or that of
        direct prediction errors; see `pilotid.time_domain.band_likelihood`.
    weighed
        Signals whose floors weigh the frequencies besides those of the model's own inputs.
    """

    band: float | None = 50.0
    wide: tuple[float, ...] = (120.0, 300.0)
    rounds: int = 3
    noise: NoiseModel | None = None
    loop: bool = True
    weighed: tuple[str, ...] = ()
