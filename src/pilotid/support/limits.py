"""Limits of all checks, of recordings and of estimates, each with its source.

A number in brackets is the largest, or least, that sound data reach: simulations of every
scenario, about 760 recordings of three generators, two of which share no code with this
project, and 110 files of human pilots.  No limit was set on what judges it: false alarms are
counted on other seeds and on a fourth generator (``nox -s check -- remarks``).
"""

from __future__ import annotations

import math
from typing import NamedTuple


class RecorderLimits(NamedTuple):
    """What a recorder does to signals, see `pilotid.checks.detectors`."""

    half_octave: tuple[float, float] = (-45.0, -52.0)  # dB, steepest of u (-38.8) and x (-45.9)
    octave: tuple[float, float] = (-54.0, -70.0)  # dB, from 1 to 9 Hz (-50.7, -64.6)
    lines: tuple[float, float] = (80.0, 60.0)  # dB, of a line over its surroundings (78, 69)
    goes_on: float = -15.0  # dB in half an octave: a fall begins where it gets as steep
    grid: float = 8.0  # mean difference over that of the smallest phase (5.6)
    slowest: float = 4.0  # Hz, of a recorder
    coarse: float = 0.2  # step over rms from which rounding hides movements
    again: float = 1e-3  # of its rms, by which a forcing function differs when it begins again
    own: float = 3e-5  # rms of e - (ft - x) over that of e (1e-15); files of 5 decimals reach it
    outlier: tuple[float, float] = (60.0, 5e-3)  # over the usual error near by (20), and over rms
    converter_steps: float = 10.0  # of a converter, that are no jump
    identity: float = 0.1  # of a sample, by which e and ft or x are apart (0)
    apart: tuple[float, float] = (0.2, 0.005)  # of a sample, and s, of u against fd (.003 s)
    long: float = 0.05  # s, of a time that noise on x does not make (.043)
    alike: float = 0.2  # by which noise on x moves the share of fd in the drive, which is 1
    biased: float = 2.0  # s for each share of u unexplained, by which noise on x moves times (1)
    answer: tuple[float, float] = (0.7, 0.003)  # the same of x: half a sample is a way to simulate
    errors: float = 5.0  # standard errors beyond which a time differs from none
    run_apart: float = 0.015  # s, of x against u in one run beside the others (.0064)
    told: float = 0.01  # s, standard error up to which a time is told
    gain: float = 0.05  # by which the share of fd in the drive differs from 1 (.014)
    no_share: float = 0.01  # of fd in the drive, that is none
    with_fd: float = 0.1  # size of u, in those of fd, that includes it: of less in another unit
    unit: float = 0.01  # by which a share differs from 180/pi to be one of units
    exact: float = 1e-3  # share of u unexplained up to which noise on x moves no share
    left: float = 0.03  # share of u, or of the answer to it, that may be unexplained
    #: Hz up to which signals must be usable for a fit to lose next to nothing: pilots have no
    #: power above 30 rad/s, and a band of 26 rad/s tells as much as a wider one.
    enough: float = 5.0


class SignalLimits(NamedTuple):
    """What is wrong with signals as such, see `pilotid.checks.checks`."""

    still: float = 1e-9  # standard deviation over the size of the signal: it does not move
    hold_e: float = 0.3  # s at one value
    jump: float = 2.5  # steps of a signal by which a held value must be left
    hold_x: float = 8.0
    hold_u: float = 10.0  # (6.5, on a breakout)
    spike: float = 100.0  # times the usual size (8; a control after steps 27)
    alone: float = 6.0  # the same of a sample that is alone (.9; of white noise 4)
    at_extreme: float = 0.06  # share of the samples at the largest or smallest value (.044)
    drift: float = 2.0  # of u over a run of 82 s, in standard deviations of what is left
    own_trend: float = 0.1  # share of a trend that the signals of the loop must leave to be told
    identity: float = 0.01  # rms of e - (ft - x) over that of e, but for noise (3e-6)
    noise: float = 0.1  # the same with the noise that channels recorded apart have
    more_coherent: float = (
        0.01  # by which e answers to u and fd more than x, if names are exchanged
    )
    shown: float = 0.5  # share of the target's fast lines that the error must show
    fastest_loop: float = 7.0  # rad/s; people cross over at 6 rad/s at most
    scaled: float = 0.02  # by which a factor between signals differs from 1 to be one of units
    same_factor: float = 0.01  # by which it may differ from line to line
    unlike_element: float = 1.3  # between the controlled elements of two runs (1.06)
    motionless_forcing: float = 0.01  # standard deviation over that of another signal


class ElementLimits(NamedTuple):
    """What output and control say of the controlled element, see `plant` and `element`."""

    coherent: float = 0.8  # squared coherence from which a band tells of the element
    negative: float = -0.3  # polarity below which an element turns the control round (least .1)
    clearly: float = 0.05  # by which coherence must be larger for a sign to be the other one
    unrelated: float = 0.91  # mean coherence below which x is not the answer to u (least .93)
    unrelated_without_fd: float = 0.3  # where a disturbance may not be recorded (least .43)
    unrelated_in_part: float = 0.65  # the same: of 36 files of people the least has .76
    changed: float = 0.35  # relative difference between the halves (.16; rate to acceleration 1.1)
    flat: float = 0.15  # relative, by which the response of an element that is a gain differs
    stands_out: float = 3.0  # times the noise from which a line tells the element's angle
    late: float = 0.1  # s by which signals are apart from which their element is not believed
    sound: float = 0.14  # share of x's amplitude left by an element whose delay tells lateness
    #: Where loops cross over: share of x's amplitude left by an element (.06; faults .12), and
    #: relative error of its response, up to which loops are drawn with it unasked.
    unexplained: float = 0.1
    slowest_pole: float = 0.6  # rad/s, of the right half-plane that is no drift of x
    pilot_delay: float = 0.17  # s, of people who stabilise: poles up to 8 rad/s (Jex 1966: 6)
    sensitivity: float = 4.0  # largest, of a loop that people close
    #: rms of the relative difference of two responses from which they are different elements; a
    #: delay of a sample or two between the recorder's channels is less.
    different: float = 0.1


class EstimateLimits(NamedTuple):
    """What speaks against an estimate, see `pilotid.likelihood.diagnostics`."""

    #: How seldom chance may speak against a fit, by each test of prediction errors: once in
    #: 14,000 recordings.
    seldom: float = 7e-5
    #: How seldom chance makes an offset or a decay that is not there one that is fitted.  With once
    #: in 14,000 an offset of u by a tenth of its rms moved estimates by up to 2 claimed errors.
    noticeable: float = 0.01
    misspecified: float = 1e-3  # p-value: doubt (5 of 800 sound fits)
    of_sample: float = 0.15  # error of a delay [samples] that a jump of the target forbids
    other_optimum: float = 3.0  # standard errors by which another optimum differs
    surely_misspecified: float = 1e-4  # p-value: wrong (2 of 800 sound fits)
    moved: float = 3.0  # errors, by which the forcing functions then move a parameter (sound: 2.3)
    #: s of all runs together from which it is tested; covariances are not good enough of less
    #: (30 s: 12 % of 120 sound fits disagreed; populations of 60 s and more: 2 of 480).
    tested_from: float = 60.0
    score_freedom: float = 30.0  # of the variances of scores (800 sound fits)
    #: Power of the share of their variance that the estimate left, by which the scatter of scores
    #: falls, and least scatter, by lines and by instruments (p of 5,000 sound fits of ten
    #: populations and strata: 1.6 to 7.4 % below .05, .3 to 3.7 % below .01).
    made_use_of: float = 1.25
    least_by_lines: float = 0.125
    least_by_instruments: float = 0.04
    dispersed: float = 0.01  # how seldom a constant pilot's scores may count as dispersed
    segment: float = 8.0  # s, of the segments whose scores are compared
    #: Lags over which prediction errors must not be correlated, in samples of a band up to so many
    #: rad/s: above, the remnant had another form than any model of it in 10 of 57 sound fits (steps
    #: and noise as forcing functions).
    lags: int = 40
    whitened_to: float = 50.0
    #: Share of samples at which u keeps its value, or one value, from which on that is no
    #: accident; a recording to 16 bits of the stick's range keeps it in .001.
    held: float = 0.02
    shared_by_halves: float = 1e-2  # least share of the information, in any direction, in each half
    independent: float = 0.01  # least share of the largest variance of autocovariances in a band
    changes_by: float = 1.0 / 3.0  # of its constant value, by which a gain or lead changes
    #: VAF [%] below which a model explains next to nothing: of 110 recordings of human pilots the
    #: least has 34 %; with the control recorded a second late the best fit has 12 %.
    least_vaf: float = 20.0
    #: % of the control at the forcing lines that a model explains whose VAF a slow remnant hides.
    surely_explained: float = 50.0
    vague: float = 0.25  # standard error over value of a parameter that is poorly identified
    shortest_delay: float = 0.1  # s, of people who track
    #: s; of 1,495 simulated fits one has a delay that is surely longer, and it is off.
    longest_delay: float = 0.5
    #: Damping ratio of a neuromuscular system below which none is published: of 2,043 simulated
    #: fits four have a determined one below, all off by more than four claimed errors.
    least_damping: float = 0.1
    least_frequency: float = 4.0  # rad/s, of a neuromuscular system
    wide: float = 10.0  # ratio of the ends of an interval: the order of magnitude is told at most
    #: Correlation from which two parameters count as one: to know the other divides a variance by
    #: 10, at which regressors are called collinear (Marquardt, Technometrics 12, 1970).
    collinear: float = math.sqrt(0.9)
    well_known: float = 0.1  # relative standard error that needs no remark
    lost_crossing: float = 0.02  # share of draws without the crossing that is worth a word


RECORDER = RecorderLimits()
SIGNAL = SignalLimits()
ELEMENT = ElementLimits()
ESTIMATE = EstimateLimits()
