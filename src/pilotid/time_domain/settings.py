"""Settings of maximum likelihood: those of its user, and every constant of the search.

Each constant is described by its source first: *statistics* is a level or bound that follows from
theory; *numerics* is precision, memory or time, and moves an estimate by far less than its error;
*tuned* was found on recordings, which are named.
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
class BandSettings:
    """Which frequencies count, see `pilotid.time_domain.band_likelihood`.

    Attributes
    ----------
    top_share
        Numerics: share of the Nyquist frequency up to which bins count: above, the filter that
        all signals pass falls off.
    outside_weight
        Tuned: weight of uncounted bins in the remnant's model; coverage is the same from .02 to 1
        (populations usual and exotic).
    min_bins
        Statistics: sum of the weights of a recording's bins below which the recorder hides the
        pilot: three for each of seven parameters.
    min_weight
        Numerics: weights below this are none.
    newton_steps
        Numerics: steps to the most likely autoregression from that of least squares.
    min_information_share
        Numerics: share of its own information on a parameter that the squares must keep beside
        the loop's.
    group_share
        Numerics: width of a group of bins over which loop and remnant hardly change, as a share
        of its frequency.
    max_group_width
        Numerics: largest width of such a group [rad/s].
    at_once_ratio
        Tuned: gain of an element an octave above the band over that at its edge from which it
        answers at once: 1 of a gain, .5 of an integrator.
    unstable_factor
        Numerics: factor on the squares of a pilot whose loop is unstable, beyond all others.
    """

    top_share: float = 0.8
    outside_weight: float = 0.1
    min_bins: float = 20.0
    min_weight: float = 1e-3
    newton_steps: int = 4
    min_information_share: float = 0.02
    group_share: float = 1.0 / 30.0
    max_group_width: float = 0.25
    at_once_ratio: float = 0.7
    unstable_factor: float = 1e3


@dataclass(frozen=True)
class SearchSettings:
    """The search for the optimum, see `pilotid.time_domain.search`.

    Attributes
    ----------
    binned_share
        Numerics: width of a bin of the binned spectra, as a share of its frequency.
    max_binned_width
        Numerics: largest width of such a bin [rad/s]: a delay of 1 s turns by 20 deg over it.
    sets_at_once
        Numerics: parameter sets of binned spectra evaluated together: what a cache holds.
    adjoint_bins
        Numerics: bins of all runs but one from which the adjoint takes less time.
    edge_share
        Numerics: share of the Nyquist frequency from which on a band is near its edge.
    max_edge_information
        Tuned: share of the information on any parameter near the edge of a loop that answers at
        once: a narrower band biases delays by up to 10 % (eight pilots in position control, 40
        runs each; docs/remnant.md).
    max_lost_information
        Tuned: share of the information near the edge of other loops, where it is lost: steps have
        .13 to .31 there, multisines .00 to .07 (populations usual and inner, seed 3003).
    lines_candidates
        Numerics: random starts screened for the pilot of the forcing lines.
    lines_refined
        Tuned: starts of these that are minimised: with 8 the optimum depended on the seed in 31 of
        175 searches of seven pilots in yaw, with 24 in 16, all of one whose weights change from
        round to round.
    lines_same_cost
        Numerics: relative difference of costs at the lines below which optima are one.
    min_vaf_ratio
        Tuned: VAF of the simulated control over that of the lines' pilot.  In populations right
        optima have .90 or more; of people in stable loops some that are usable have little more
        than half (subject gy with `pursuit`).
    first_tolerance
        Numerics: relative decrease of the cost at which a first fit with a second-order remnant
        ends.
    first_iterations
        Numerics: largest number of iterations of that fit.
    sweep_tolerance
        Numerics: relative decrease of the cost at which the sweep over all starts ends.
    sweep_iterations
        Numerics: iterations after which the best of the sweep go on.
    sweep_survivors
        Numerics: how many of the sweep's starts go on.
    sweep_deviance
        Tuned: deviance by which an optimum of the sweep may be worse than the best: the sweep's
        whitening favours the pilot that it is from (populations).
    candidate_deviance
        Tuned: deviance by which a candidate with its own remnant may be worse: binned spectra
        missed 170 once, and a right optimum was left out for it (populations).
    max_candidates
        Numerics: optima that are looked at closely.
    same_optimum_distance
        Statistics: squared distance of ends in standard errors below which they are one.
    look_tolerance
        Numerics: relative decrease that ends a first look.
    look_criterion
        Tuned: by which a candidate's criterion may be higher then (populations).
    compared_tolerance
        Numerics: relative decrease that ends fits that are compared, and searches that creep
        along a flat valley.
    steps_ahead
        Numerics: what such fits are still short of, in steps of their tolerance.
    reported_tolerance
        Numerics: relative decrease of the cost that ends the fit that is reported.
    contender_criterion
        Tuned: by which remnant models may differ to be fitted both: the residual of a first
        estimate decides no more than that (populations).
    band_pass_penalty
        Tuned: by which a band-pass must predict better, since its corner and the gain explain one
        another (nominal, seed 1; exotic, seed 1502; docs/remnant.md).
    neighbour_criterion
        Numerics: by which a longer or shorter autoregression must be better.
    competing_criterion
        Statistics: by which another optimum's criterion may be higher to compete: more than the
        3.84 of an interval's end.
    same_criterion
        Numerics: difference of criteria below which two optima are one.
    term_rounds
        Numerics: how often the nuisance terms are chosen anew at most.
    same_decay
        Numerics: relative difference of time constants below which free decays are one.
    change_tolerance
        Numerics: relative decrease that ends searches for other times of a change.
    change_iterations
        Numerics: largest number of iterations of searches for other times.
    """

    binned_share: float = 1.0 / 15.0
    max_binned_width: float = 0.35
    sets_at_once: int = 12
    adjoint_bins: int = 8000
    edge_share: float = 0.6
    max_edge_information: float = 0.01
    max_lost_information: float = 0.1
    lines_candidates: int = 96
    lines_refined: int = 24
    lines_same_cost: float = 0.01
    min_vaf_ratio: float = 0.5
    first_tolerance: float = 3e-3
    first_iterations: int = 12
    sweep_tolerance: float = 1e-3
    sweep_iterations: int = 8
    sweep_survivors: int = 9
    sweep_deviance: float = 1000.0
    candidate_deviance: float = 300.0
    max_candidates: int = 5
    same_optimum_distance: float = 4.0
    look_tolerance: float = 1e-3
    look_criterion: float = 20.0
    compared_tolerance: float = 1e-6
    steps_ahead: float = 10.0
    reported_tolerance: float = 1e-10
    contender_criterion: float = 20.0
    band_pass_penalty: float = 7.0
    neighbour_criterion: float = 0.1
    competing_criterion: float = 5.0
    same_criterion: float = 0.01
    term_rounds: int = 4
    same_decay: float = 0.1
    change_tolerance: float = 1e-4
    change_iterations: int = 20


@dataclass(frozen=True)
class ProfileSettings:
    """Intervals, see `pilotid.time_domain.profile`.

    Attributes
    ----------
    bartlett_seconds
        Tuned: over the scored time, by how much likelihood ratios exceed chi-squared, as pilot
        and remnant share what there is (short, seeds from 1000; docs/remnant.md).
    max_moves
        Numerics: how often a profile that finds a better optimum moves the estimate there.
    fixed_tolerance
        Numerics: relative decrease that ends fits with a parameter fixed.
    fixed_iterations
        Numerics: largest number of iterations of fits with a parameter fixed.
    change_tolerance
        Numerics: relative decrease that ends fits with the time or rate of a change fixed.
    change_iterations
        Numerics: largest number of iterations of fits with the time or rate of a change fixed.
    shifts_beyond
        Tuned: seconds beyond an interval at which the time of a change is tried (adapting-slow,
        adapting-fast; docs/adapting.md).
    rates_beyond
        Tuned: rates at which such a time is tried [1/s] (adapting-slow, adapting-fast).
    rates
        Numerics: rates that are tried [1/s]: about two a decade.
    shifts_around
        Numerics: seconds about the time at which a rate is tried.
    """

    bartlett_seconds: float = 5.0
    max_moves: int = 3
    fixed_tolerance: float = 1e-5
    fixed_iterations: int = 20
    change_tolerance: float = 1e-3
    change_iterations: int = 10
    shifts_beyond: tuple[float, ...] = (0.25, 0.75, 1.5, 2.5, 4.0, 6.0)
    rates_beyond: tuple[float, ...] = (0.4, 20.0)
    rates: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8, 2.0, 6.0, 20.0, 100.0)
    shifts_around: tuple[float, ...] = (-2.0, -1.0, 0.0, 1.0, 2.0)


BAND = BandSettings()
SEARCH = SearchSettings()
PROFILE = ProfileSettings()
