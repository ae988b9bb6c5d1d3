"""Settings of maximum likelihood: those of its user, and the constants that decide a search.

Numbers that bear on precision, memory or time alone stand where they are used.  Each constant here
is described by its source first: *statistics* is a level or bound that follows from theory;
*numerics* is precision, memory or time, and moves an estimate by far less than its error; *tuned*
was found on recordings, which are named.
"""

from __future__ import annotations

from dataclasses import dataclass

from pilotid.likelihood.remnant_models import NoiseModel


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
        Wider bands to try, in order, while there is too much information near the edge of the one
        before; empty for none.  They widen the default band alone: one that is asked for stays.
    rounds
        How often the remnant's model is chosen anew at most.
    noise
        The remnant's model, where it is not to be chosen.
    loop
        Whether the likelihood is that of the band, which needs the controlled element, or that of
        direct prediction errors; see `pilotid.likelihood.band_likelihood`.
    weighed
        Signals whose floors weigh the frequencies besides those of the model's own inputs.
    """

    band: float | None = 50.0
    wide: tuple[float, ...] = (120.0, 300.0)
    rounds: int = 3
    noise: NoiseModel | None = None
    loop: bool = True
    weighed: tuple[str, ...] = ()


#: Tuned: share of the information on any parameter near the edge of the band of a loop that answers
#: at once: a narrower band biases delays by up to 10 % (eight pilots in position control, 40 runs
#: each).
MAX_EDGE_INFORMATION = 0.01
#: Tuned: the same of other loops, where it is lost: steps have .13 to .31 there, multisines .00 to
#: .07 (populations usual and inner, seed 3003).
MAX_LOST_INFORMATION = 0.1
#: Tuned: VAF of the simulated control over that of the lines' pilot.  In populations right optima
#: have .90 or more; of people in stable loops some that are usable have little more than half
#: (subject gy with `pursuit`).
MIN_VAF_RATIO = 0.5
#: Statistics: squared distance of ends in standard errors below which they are one.
SAME_OPTIMUM_DISTANCE = 4.0
#: Tuned: by which the criterion may be higher of a candidate on a first look, and of a remnant's
#: model beside what a first pilot leaves (populations).
LOOK_CRITERION = 20.0
#: Numerics: relative decrease that ends fits that are compared, and searches that creep along a
#: flat valley.
COMPARED_TOLERANCE = 1e-6
#: Numerics: relative decrease of the cost that ends the fit that is reported.
REPORTED_TOLERANCE = 1e-10
#: Tuned: by which a band-pass must predict better, since its corner and the gain explain one
#: another (nominal, seed 1; exotic, seed 1502).
BAND_PASS_PENALTY = 7.0
#: Statistics: by which another optimum's criterion may be higher to compete: more than the 3.84 of
#: an interval's end.
COMPETING_CRITERION = 5.0
#: Tuned: over the scored time, by how much likelihood ratios exceed chi-squared, as pilot and
#: remnant share what there is [s] (short, seeds from 1000).
BARTLETT_SECONDS = 5.0
#: Tuned: deviance below which a recording does not tell an unusual neuromuscular system from a
#: usual one: the best of many local optima exceeds the truth by up to 13 (disturbances of low
#: frequency alone, 60 recordings).
USUAL_SYSTEM_DEVIANCE = 15.0
