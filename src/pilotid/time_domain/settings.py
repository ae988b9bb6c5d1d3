"""Settings of maximum likelihood: those of its user, and the constants that decide a search.

Numbers that bear on precision, memory or time alone stand where they are used.  Each constant here
is described by its source first: *statistics* is a level or bound that follows from theory;
*numerics* is precision, memory or time, and moves an estimate by far less than its error; *tuned*
was found on recordings, which are named.
"""

from __future__ import annotations

from dataclasses import dataclass

from pilotid.time_domain.remnant_models import NoiseModel


@dataclass(frozen=True)
class StartSettings:
    """From where the optimum is searched.

    Attributes
    ----------
    search_band
        Narrow and cheap band in which the first optimum is searched [rad/s].
    candidates, refined
        Random starts screened, and starts minimised, see `pilotid.solve.search.search`.
    """

    search_band: float = 26.0
    candidates: int = 6
    refined: int = 2


@dataclass(frozen=True)
class LikelihoodSettings(StartSettings):
    """How the likelihood of pilot and remnant is maximised.

    Attributes
    ----------
    search_band, candidates, refined
        See `StartSettings`.
    band
        Analysis band [rad/s]; None uses the full sampling rate.
    wide
        Wider bands, of which the first takes its place that is not informative near its edge;
        empty for none.  They widen the default band alone: one that is asked for stays.
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


@dataclass(frozen=True)
class SearchSettings:
    """The search for the optimum, see `pilotid.time_domain.search`.

    Attributes
    ----------
    max_binned_width
        Numerics: largest width of a bin of the binned spectra [rad/s]: a delay of 1 s turns by
        20 deg over it.
    adjoint_bins
        Numerics: bins of all runs but one from which the adjoint takes less time.
    max_edge_information
        Tuned: share of the information on any parameter near the edge of a loop that answers at
        once: a narrower band biases delays by up to 10 % (eight pilots in position control, 40
        runs each).
    max_lost_information
        Tuned: share of the information near the edge of other loops, where it is lost: steps have
        .13 to .31 there, multisines .00 to .07 (populations usual and inner, seed 3003).
    lines_refined
        Tuned: starts that are minimised for the pilot of the forcing lines: with 8 the optimum
        depended on the seed in 31 of 175 searches of seven pilots in yaw, with 24 in 16, all of
        one whose weights change from round to round.
    min_vaf_ratio
        Tuned: VAF of the simulated control over that of the lines' pilot.  In populations right
        optima have .90 or more; of people in stable loops some that are usable have little more
        than half (subject gy with `pursuit`).
    sweep_deviance
        Tuned: deviance by which an optimum of the sweep may be worse than the best: the sweep's
        whitening favours the pilot that it is from (populations).
    candidate_deviance
        Tuned: deviance by which a candidate with its own remnant may be worse: binned spectra
        missed 170 once, and a right optimum was left out for it (populations).
    same_optimum_distance
        Statistics: squared distance of ends in standard errors below which they are one.
    look_criterion
        Tuned: by which a candidate's criterion may be higher on a first look (populations).
    compared_tolerance
        Numerics: relative decrease that ends fits that are compared, and searches that creep
        along a flat valley.
    reported_tolerance
        Numerics: relative decrease of the cost that ends the fit that is reported.
    contender_criterion
        Tuned: by which remnant models may differ to be fitted both: the residual of a first
        estimate decides no more than that (populations).
    band_pass_penalty
        Tuned: by which a band-pass must predict better, since its corner and the gain explain one
        another (nominal, seed 1; exotic, seed 1502).
    competing_criterion
        Statistics: by which another optimum's criterion may be higher to compete: more than the
        3.84 of an interval's end.
    """

    max_binned_width: float = 0.35
    adjoint_bins: int = 2500
    max_edge_information: float = 0.01
    max_lost_information: float = 0.1
    lines_refined: int = 24
    min_vaf_ratio: float = 0.5
    sweep_deviance: float = 1000.0
    candidate_deviance: float = 300.0
    same_optimum_distance: float = 4.0
    look_criterion: float = 20.0
    compared_tolerance: float = 1e-6
    reported_tolerance: float = 1e-10
    contender_criterion: float = 20.0
    band_pass_penalty: float = 7.0
    competing_criterion: float = 5.0


SEARCH = SearchSettings()

#: Tuned: over the scored time, by how much likelihood ratios exceed chi-squared, as pilot and
#: remnant share what there is [s] (short, seeds from 1000).
BARTLETT_SECONDS = 5.0
