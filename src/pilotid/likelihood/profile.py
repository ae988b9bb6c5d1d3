"""Profile-likelihood intervals of the pilot, about the optimum and all that is as likely.

The search may have come upon other local optima that are nearly as high.  Where the optimum lies
at a bound, the likelihood is far from a parabola and often has another optimum inside the bounds:
a slow neuromuscular system with a short delay resembles a fast one with a long delay.  So each
parameter at a bound is fixed at usual values, and the others are fitted: those of a neuromuscular
system together (`over_systems`), others one by one (`off_bounds`).  Whatever is as likely as the
ends of an interval belongs into the intervals, and a usual neuromuscular system in place of an
unusual one even where it is a little less likely.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import product

import numpy as np

from pilotid.estimate.estimate import Estimate, is_at_bound
from pilotid.likelihood.optimum import Optimum, best_of
from pilotid.model.factors import Neuromuscular
from pilotid.solve.intervals import Profile, covariance_at_bounds, errors_from, profile_intervals
from pilotid.solve.least_squares import Bounds, Box, Minima, minimise
from pilotid.support.numbers import CHI_SQUARED_95, CHI_SQUARED_95_OF_TWO, Z95, covariance_of
from pilotid.support.types import FloatArray

#: Tuned: deviance below which a recording does not tell an unusual neuromuscular system from a
#: usual one: the best of many local optima exceeds the truth by up to 13 (disturbances of low
#: frequency alone, 60 recordings).
USUAL_SYSTEM_DEVIANCE = 15.0
#: Frequencies [rad/s] and damping ratios of the neuromuscular systems of most people.
FREQUENCIES, DAMPINGS = (8.0, 11.0, 15.0), (0.2, 0.3, 0.6)
#: Standard errors of a damping ratio beyond which it is surely another one.
SURE = 10.0
#: Damping ratio of no person: a resonance so narrow may be that of a few frequencies.
SLIGHT = 0.03


def profile_likelihood(optimum: Optimum) -> tuple[Optimum, Profile | None]:
    """Profile the likelihood, and go to a better optimum that is come upon.

    Parameters
    ----------
    optimum
        The optimum of a search.

    Returns
    -------
    The best optimum, and the profile about it; None where the remnant has no shape, and of what is
    no pilot, whose ridges take long.
    """
    profile = profile_about(optimum) if optimum.rank > 0 else None
    for _ in range(3):
        if profile is None or profile.better is None:
            break
        moved = optimum.restarted_at(profile.better)
        if moved.rank < optimum.rank or best_of([moved, optimum]) is optimum:
            break
        if not moved.is_near(optimum.pilot):
            moved = replace(moved, others=[*moved.others, optimum])
        if (there := profile_about(moved)) is None:
            break  # singular: its errors would be those of a likelihood that is a ridge
        optimum, profile = moved, there
    return optimum, profile


def with_profile(estimate: Estimate, optimum: Optimum, profile: Profile) -> Estimate:
    """An estimate with the intervals of a profile, and the standard errors that belong to them.

    Parameters
    ----------
    estimate
        The estimate with the covariance of the likelihood's curvature.
    optimum, profile
        See `profile_likelihood`.
    """
    sought, covariance = deviances(optimum), estimate.covariance
    intervals = over_systems(optimum, profile.intervals)
    # With another model of the remnant, or jumps at samples, a pilot may be as likely.
    ends = (end for rival in optimum.rivals for end in _ends_beside(rival, optimum, intervals))
    intervals = _holding(intervals, [*ends, *optimum.competing])
    # The length of an interval tells the scatter of skewed estimates; the likelihood's
    # curvature at its maximum, from which the covariance is, only the middle of it.
    reach = np.sqrt(sought / optimum.variance_factor)
    errors = errors_from(estimate.values, intervals, estimate.model, reach)
    estimate = replace(estimate, intervals=intervals, errors=errors)
    at_bound = is_at_bound(estimate.model, estimate.values)
    if not at_bound.any():
        return estimate
    information = np.asarray(np.linalg.inv(covariance))
    inside = covariance_at_bounds(
        information, at_bound, errors_from(estimate.values, profile.intervals, estimate.model)
    )
    return estimate if inside is None else replace(estimate, covariance=inside)


def _ends_beside(rival: Optimum, optimum: Optimum, intervals: FloatArray) -> FloatArray:
    """Ends of intervals about a rival, shape (2, parameters).

    They are as far from it as those about the optimum, times the ratio of standard errors.  A
    profile of its own takes a sixth of a fit and tells little more (coverage of 180 hard remnants
    .953 in place of .951).
    """
    own, its, model = optimum.covariance, rival.covariance, optimum.joint.prediction.model
    if own is None or its is None:
        return intervals.T
    ratio = np.sqrt(np.diag(its) / np.diag(own))
    return np.clip(rival.pilot + ratio * (intervals.T - optimum.pilot), model.lower, model.upper)


def profile_about(optimum: Optimum) -> Profile | None:
    """Intervals about an optimum that hold others as far as they are as likely."""
    joint, end = optimum.joint, optimum.end
    if covariance_of(optimum.information, optimum.variance) is None:
        return None
    # Beside another remnant than they were found with.
    starts = [np.append(o.pilot, optimum.values[joint.pilot_count :]) for o in optimum.others]
    others = [_ends(optimum, np.array(starts), joint).values] if starts else []
    return profile_intervals(
        optimum.search_problem.gram,
        joint,
        end,
        optimum.variance,
        joint.pilot_count,
        estimated=optimum.freedom,
        widened=deviances(optimum) / CHI_SQUARED_95,
        others=np.concatenate([*others, off_bounds(optimum)]),
    )


def off_bounds(optimum: Optimum) -> FloatArray:
    """Optima with parameters held off their bounds, pilot and remnant, shape (points, parameters).

    Parameters
    ----------
    optimum
        The optimum; without a parameter at a bound there are none.  Those of neuromuscular systems
        are not among them, see `over_systems`.
    """
    joint, model = optimum.joint, optimum.joint.prediction.model
    at_bound = is_at_bound(model, optimum.pilot)
    at_bound[model.indices_of(Neuromuscular)] = False
    (low, high), inside = model.usual, _inside(optimum)
    # What the lines show rests on no model of the remnant.
    starts = np.array([inside, *(np.append(p, inside[len(p) :]) for p in optimum.lines_pilot)])
    points = []
    for k in np.flatnonzero(at_bound).tolist():
        ends = starts  # the bounds give a held parameter its value in all starts
        for value in (inside[k], low[k], high[k]):
            ends = _ends(optimum, ends, Box.holding(joint, k, value)).values
            points.append(ends)
    return np.concatenate([np.zeros((0, len(inside))), *points])


def _inside(optimum: Optimum) -> FloatArray:
    """The optimum with what lies at bounds in the middle of its usual range, (parameters,)."""
    model, pilot = optimum.joint.prediction.model, optimum.pilot
    low, high = model.usual
    middle = np.where(model.positive, np.sqrt(np.abs(low * high)), 0.5 * (low + high))
    inside = np.where(is_at_bound(model, pilot), middle, pilot)
    return np.append(inside, optimum.values[pilot.size :])


def _ends(optimum: Optimum, starts: FloatArray, space: Bounds) -> Minima:
    """Where starts end, best first, one of each optimum."""
    gram = optimum.search_problem.gram
    return minimise(gram, starts, space, tolerance=1e-5, iterations=20, merge=True)


def deviances(optimum: Optimum) -> FloatArray:
    """Deviance that the intervals of the pilot's parameters go to, shape (parameters,).

    When a change was and how fast are one event with many optima, and the likeliest of these
    exceeds the truth by more than a single parameter's share: intervals of both are the shadows of
    their joint region, that of two degrees of freedom.
    """
    sought = np.full(optimum.joint.pilot_count, CHI_SQUARED_95)
    sought[list(optimum.joint.prediction.model.change)] = CHI_SQUARED_95_OF_TWO
    return np.asarray(optimum.variance_factor * sought)


def over_systems(optimum: Optimum, intervals: FloatArray) -> FloatArray:
    """Intervals (parameters, 2) that hold a usual neuromuscular system, too, if it may be true.

    Where forcing functions tell little of the system, the likelihood has many local optima, narrow
    resonances among them, and the best exceeds the truth by more than chi-squared allows.  So an
    unusual system is held against one of usual damping and frequency, and intervals hold those
    about the likeliest pilot with such a system.

    Parameters
    ----------
    optimum
        The optimum.
    intervals
        Those of the profile about it.
    """
    joint, model = optimum.joint, optimum.joint.prediction.model
    for f, d in [at for factor, at in model.moving if isinstance(factor, Neuromuscular)]:
        start = optimum.values.copy()
        usual = (
            FREQUENCIES[0] < start[f] < FREQUENCIES[-1] and DAMPINGS[0] < start[d] < DAMPINGS[-1]
        )
        error = math.log(intervals[d, 1] / intervals[d, 0]) / (2.0 * Z95)
        sure = abs(math.log(start[d] / DAMPINGS[1])) > SURE * error and start[d] > SLIGHT
        if usual or sure:
            continue
        limit = float(optimum.end.cost[0]) * math.exp(
            optimum.variance_factor * USUAL_SYSTEM_DEVIANCE / optimum.freedom
        )
        starts = np.unique([start, _inside(optimum)], axis=0)
        systems = np.array([*product(FREQUENCIES, DAMPINGS[1:])])
        points = np.repeat(starts, len(systems), axis=0)
        points[:, [f, d]] = np.tile(systems, (len(starts), 1))
        # The sum of all delays, which is known best, stays.
        lags = 2.0 * (start[d] / start[f] - points[:, d] / points[:, f])
        points[:, list(model.delays)] += lags[:, None]

        def gram(values: FloatArray, held: tuple[int, ...] = (f, d)) -> FloatArray:
            """That of the others: nothing moves the system."""
            grams = optimum.search_problem.gram(values)
            for k in held:
                grams[:, k], grams[:, :, k], grams[:, k, k] = 0.0, 0.0, 1.0
            return grams

        ends = minimise(gram, points, joint, tolerance=1e-3, iterations=20, above=limit)
        ends = ends.only(ends.cost < limit)
        if len(ends.cost):
            free = np.delete(np.arange(len(start)), [f, d])
            covariance = covariance_of(ends.gram[0][np.ix_(free, free)], optimum.variance)
            reach = np.zeros(len(start))
            if covariance is not None:
                reach[free] = Z95 * np.sqrt(np.diag(covariance))
            about = ends.values[0] + np.outer([-1.0, 1.0], reach)
            points = np.array([*np.clip(about, joint.lower, joint.upper), *ends.values])
            intervals = _holding(intervals, points[:, : joint.pilot_count])
    return intervals


def _holding(intervals: FloatArray, points: Iterable[FloatArray]) -> FloatArray:
    """Intervals (parameters, 2) that hold points (parameters,), too."""
    every = np.array([*intervals.T, *points])
    return np.stack([every.min(axis=0), every.max(axis=0)], axis=1)
