"""Scores of methods over recordings: functions of a study's frame, and of plain arrays.

`score` makes a row of scores for each scenario, method and parameter of a study's frame (see
`pilotid.study.table.Results`).  The functions of arrays take what is known of one parameter, shape
(fits,), or of several; what failed is left out beforehand.  Too few values for a score give NaN.
Values of one recording depend on one another, so that scores over several parameters take the
recording of each value (``clusters``) and have the Monte Carlo error of clusters.

The loss
--------
A fit says between which values a parameter lies with 95 % confidence.  `interval_score` (Gneiting
and Raftery, *Strictly proper scoring rules, prediction, and estimation*, JASA 102(477) 2007, eq.
43; R. L. Winkler, JASA 67(337) 1972) charges the interval's width and, where it misses the truth,
2/.05 = 40 times the distance by which it does.  Of an exact, efficient normal estimator, whose
standard error is the Cramer-Rao bound b, the interval is the value ± 1.96 b, and the score is on
average

    2 * 1.96 b + 40 * 2 E[(z - 1.96)+] b = (3.920 + 40 * 0.01889) b = 4.676 b,

since E[(z - c)+] = phi(c) - c (1 - Phi(c)) = 0.009445 for c = 1.96 and z a standard normal
variable, on either side.  The **loss** is the score over 4.676 times the recording's own bound:
an exact, efficient estimator has 1, and bias, scatter, intervals too short and intervals too long
all cost.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import crc32

import numpy as np

from pilotid.estimate.estimate import Outcome
from pilotid.support.format import number
from pilotid.support.numbers import Z95, rms
from pilotid.support.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from pandas import DataFrame, Series

ALL = "all"  # stands for all parameters, and for all recordings
LOSS = ("loss", "loss_lower", "loss_upper")
MISSED = 40.0  # what a missed distance costs: 2 over the chance that a 95 % interval misses
#: E[(|z| - 1.96)+] of a standard normal variable: twice phi(c) - c (1 - Phi(c)).
SHORTFALL = 2.0 * (math.exp(-0.5 * Z95**2) / math.sqrt(2.0 * math.pi) - 0.025 * Z95)
#: Expected interval score of an exact, efficient normal estimator with the standard error 1.
EFFICIENT = 2.0 * Z95 + MISSED * SHORTFALL
#: The variance of its loss: (E[(|z| - c)+^2] - SHORTFALL^2) (40/4.676)^2.
EFFICIENT_VARIANCE = (0.05 - Z95 * SHORTFALL - SHORTFALL**2) * (MISSED / EFFICIENT) ** 2
RESAMPLES = 1000
ROUNDING = 1e-12  # what is smaller, of logarithms and of their variances, is zero
FAR_OFF = 3.0  # an honest standardised error is beyond this in 0.27 % of all cases
#: A fit ends in a wrong optimum if its criterion exceeds that of a search from the truth by more.
WRONG = 4.0
TRIMMED = 0.01  # share of the largest errors that the trimmed score leaves out
MEDIAN_SIZE = 0.674490  # median of the absolute value of a standard normal variable


class Mean(NamedTuple):
    """A mean or a share, and its Monte Carlo standard error; NaN where there is none."""

    value: float
    error: float


def loss_text(loss: float, lower: float = math.nan, upper: float = math.nan) -> str:
    """A loss with the digits that it deserves, and its interval if there is one."""
    text = f"{loss:.2f}" if loss < 9.995 else number(loss)
    return f"{text} ({loss_text(lower)}-{loss_text(upper)})" if math.isfinite(upper) else text


# ---------------------------------------------------------------------------- a study's frame


def measured(frame: DataFrame) -> DataFrame:
    """A study's frame with what scores are made of, for each parameter of each fit.

    The columns added are ``first``, which row is the first of a fit; ``tried``, whether the method
    can treat the recording; ``error``, of fits that count, ``z``, the same over the claimed error,
    and ``ratio``, over the bound; ``hit``, whether the interval holds the truth, NaN without one;
    ``low`` and ``high``, the ends of the interval or of that which the standard error makes;
    ``loss``, NaN where there is none; and ``warned``, whether a user is told something of the fit.

    What failed, and an interval that is missing though others of the method are not, is charged
    with the interval from zero to twice the true value, and no interval counts beyond these ends:
    nobody gains by failing where an honest interval is wide.  An objection is no try if the method
    objects to all recordings of the scenario, and a failure else.  A method that succeeds without
    any interval has no loss.
    """
    d = frame.copy()
    cells = [d.scenario, d.method]
    d["first"] = ~d.duplicated(["scenario", "method", "replication"])
    objects = d.outcome == Outcome.NOT_APPLICABLE.slug
    d["tried"] = ~objects.groupby(cells).transform("all")
    d["error"] = (d.value - d.truth).where(d.usable)
    claimed = d.std_error.where(d.std_error > 0.0)
    d["z"], d["ratio"] = d.error / claimed, d.error / d.bound
    has_interval = d.lower.notna() & d.upper.notna()
    hit = (d.lower <= d.truth) & (d.truth <= d.upper)
    d["hit"] = hit.astype(float).where(has_interval & d.error.notna())
    d["low"] = d.lower.where(has_interval, d.value - Z95 * claimed)
    d["high"] = d.upper.where(has_interval, d.value + Z95 * claimed)
    ends = np.minimum(0.0, 2.0 * d.truth), np.maximum(0.0, 2.0 * d.truth)
    low, high = (end.clip(*ends) for end in (d.low, d.high))
    score = interval_score(low, high, d.truth).where(d.usable)
    some = score.notna().groupby(cells).transform("any")
    none = d.usable.groupby(cells).transform("any") & ~some
    charged = score.fillna(2.0 * d.truth.abs()) / (EFFICIENT * d.bound)
    d["loss"] = charged.where(d.tried & ~none)
    d["warned"] = (d.remarks != "") | ~d.usable
    return d


def parameters_of(cell: DataFrame) -> list[str]:
    """The parameters of a scenario's fits; those of large models in front, in their order."""
    known = cell[cell.truth.notna()]
    models = known.groupby("model").parameter.unique()
    ordered = sorted(models.items(), key=lambda each: (-len(each[1]), each[0]))
    return list(dict.fromkeys(key for _, keys in ordered for key in keys))


def score(measured: DataFrame) -> DataFrame:
    """Scores of all parameters and of each, in each scenario and in each part of a population.

    A row has scenario, method, ``stratum`` and ``value`` (``all`` for all recordings), parameter,
    and scores: counts of recordings that the method can treat, of values that count, of failures
    and objections; with the standard error (``_se``) of each where there is one, bias, standard
    deviation and root mean square error in the parameter's unit, NaN where recordings have truths
    of their own; coverage of the 95 % intervals, its own 95 % interval, and how many independent
    intervals (``worth``) they are; of error over claimed error mean, skewness, root mean square,
    the same with 1 % left out and the share beyond 3; of error over bound the root mean square and
    its counterpart of the median; fits in a wrong optimum, of those (``optima``) for which that
    is known; the loss with its 95 % interval, and that of the fits that ended well; median seconds
    of a fit; and recordings of which a user is told something.

    Parameters
    ----------
    measured
        What the function of that name makes.
    """
    from pandas import DataFrame

    rows: list[dict[str, Any]] = []
    for name in measured.scenario.unique():
        scenario = measured[measured.scenario == name]
        parts = strata_of(scenario) if scenario.population.iloc[0] else {}
        for method, cell in scenario.groupby("method", sort=False):
            keys, front = parameters_of(cell), {"scenario": name, "method": method}
            columns = {column: cell[column].to_numpy() for column in USED}
            columns["recording"] = cell.replication.factorize()[0]
            chosen_of = {(ALL, ALL): np.ones(len(cell), dtype=bool)}
            for stratum, labels in parts.items():
                label_of = cell.replication.map(labels)
                for value in sorted(labels.unique(), key=_in_order):
                    chosen_of[stratum, value] = np.asarray(label_of == value)
            for (stratum, value), chosen in chosen_of.items():
                chosen_columns = {column: values[chosen] for column, values in columns.items()}
                part = front | {"stratum": stratum, "value": value}
                rows += [part | scores for scores in _scores_of(chosen_columns, keys, str(name))]
    return DataFrame(rows)


#: Columns of what is measured that scores are made of.
USED = (
    *("parameter", "first", "tried", "usable", "posterior", "warned", "population", "truth"),
    *("bound", "value", "std_error", "seconds", "excess", "error", "z", "ratio", "hit", "loss"),
)


def _scores_of(columns: dict[str, Any], keys: list[str], name: str) -> Iterator[dict[str, Any]]:
    """What all parameters together have scored, and each."""
    losses = np.full((columns["recording"].max(initial=-1) + 1, len(keys)), math.nan)
    of_key = {key: columns["parameter"] == key for key in keys}
    for place, rows in enumerate(of_key.values()):
        losses[columns["recording"][rows], place] = columns["loss"][rows]
    well = [mean(columns["loss"][rows & columns["usable"]]) for rows in of_key.values()]
    ended = [geometric_mean(well), *well]
    all_losses = mean_losses(losses, name)
    every = {ALL: np.ones(columns["parameter"].size, dtype=bool), **of_key}
    for (key, rows), loss, good in zip(every.items(), all_losses.tolist(), ended, strict=True):
        these = {column: values[rows] for column, values in columns.items()}
        last = dict(zip(LOSS, loss, strict=True)) | {"loss_ended_well": good}
        yield {"parameter": key} | _row(these, key) | last


def _row(columns: dict[str, Any], key: str) -> dict[str, Any]:
    """What one parameter, or all, have scored but for the loss."""
    fits = columns["first"] | (key != ALL)
    tried, usable, warned, excess, seconds = (
        columns[name][fits] for name in ("tried", "usable", "warned", "excess", "seconds")
    )
    excess, seconds = excess[tried & np.isfinite(excess)], seconds[np.isfinite(seconds)]
    error = np.isfinite(columns["error"])
    claims, bounded, given = (error & np.isfinite(columns[name]) for name in ("z", "ratio", "hit"))
    z, of_z = columns["z"][claims], columns["recording"][claims]
    ratio, of_ratio = columns["ratio"][bounded], columns["recording"][bounded]
    cover, ends, worth = coverage(columns["hit"][given] > 0.0, columns["recording"][given])
    one = key != ALL and error.size > 0 and not columns["population"][0]
    truth, bound = (columns["truth"][0], columns["bound"][0]) if one else (math.nan, math.nan)
    values = columns["value"][error] if one else np.zeros(0)
    claimed = mean(columns["std_error"][error]) if one else math.nan
    off = bias(values, truth)
    pairs = {
        ("bias", "bias_se"): off,
        ("coverage_95", "coverage_se"): cover,
        ("mean_z", "mean_z_se"): clustered_mean(z, of_z),
        ("rms_z", "rms_z_se"): root_mean_square(z, of_z),
        ("rms_z_trimmed", "rms_z_trimmed_se"): trimmed(z, of_z),
        ("beyond_3", "beyond_3_se"): beyond(z, of_z),
        ("rmse_over_bound", "rmse_over_bound_se"): root_mean_square(ratio, of_ratio),
    }
    return {
        "recordings": int(tried.sum()),
        "n": int(error.sum()),
        "usable": int(usable.sum()),
        "failures": int((tried & ~usable).sum()),
        "not_applicable": int((~tried).sum()),
        "truth": truth,
        "crlb": bound,
        "bias_percent": 100.0 * off[0] / truth if truth else math.nan,
        "std": spread(values),
        "rmse": rmse(values, truth),
        "mean_std_error": claimed,
        "posterior_std": claimed if columns["posterior"].any() else math.nan,
        "coverage_lower": ends[0],
        "coverage_upper": ends[1],
        "worth": worth,
        "z_skew": skewness(z),
        "median_over_bound": typical(ratio),
        "wrong_optima": int((excess > WRONG).sum()),
        "optima": int(excess.size),
        "seconds": float(np.median(seconds)) if seconds.size else math.nan,
        "warned": int((tried & warned).sum()),
        **{name: x for names, pair in pairs.items() for name, x in zip(names, pair, strict=True)},
    }


def loss_ratios(first: DataFrame, second: DataFrame) -> DataFrame:
    """Ratios of the first method's losses to the second's on the recordings that both have.

    Parameters
    ----------
    first, second
        Rows of `measured` of one scenario; the bounds of the second count.

    Returns
    -------
    ``loss``, ``loss_lower`` and ``loss_upper`` of all parameters together and of each, by key.
    """
    from pandas import DataFrame

    both = first.merge(second, on=["replication", "parameter"], suffixes=("", "_other"))
    both = both[both.truth.notna() & both.truth_other.notna()]
    keys = [key for key in parameters_of(first) if (both.parameter == key).any()]
    scaled = both.assign(loss=both.loss * both.bound / both.bound_other)
    ours, theirs = (
        np.asarray(scaled.pivot(index="replication", columns="parameter", values=name)[keys])
        for name in ("loss", "loss_other")
    )
    ratios = mean_losses(ours, first.scenario.iloc[0], theirs)
    return DataFrame(ratios, [ALL, *keys], LOSS)


# ------------------------------------------------------------------------------------ strata


def strata_of(scenario: DataFrame) -> dict[str, Series]:
    """The part of a population that each replication is in, by the fact that divides it.

    Facts that vary in steps have a part for each value; remnant level and length are
    divided into thirds of the recordings.

    Parameters
    ----------
    scenario
        The frame's rows of a population.
    """
    facts = scenario[scenario.model != ""].drop_duplicates("replication").set_index("replication")
    return {
        "model": facts.model,
        "element": facts.element.fillna("?").astype(str),
        "remnant": facts.remnant.fillna("?").astype(str),
        "level": _thirds(facts.remnant_level, 100.0, "%"),
        "rate": (1.0 / facts.dt).map("{:.0f} Hz".format),
        "length": _thirds(facts.duration, 1.0, "s"),
        "run-in": facts.run_in.map("{:.0f} s".format),
        "runs": facts.runs.map(lambda runs: "1 run" if runs == 1 else f"{runs:.0f} runs"),
        "forcing": facts.forcing.fillna("?").astype(str),
    }


def _in_order(label: str) -> tuple[float, str]:
    """Numbers by their size, words by the alphabet behind them."""
    first = label.split()[0] if label.split() else ""
    return (float(first), label) if first.replace(".", "").isdecimal() else (math.inf, label)


def _thirds(numbers: Series, scale: float, unit: str) -> Series:
    """In which third of the recordings each is by a number; fewer where many have the same."""
    known = numbers.dropna().round(6)
    if not len(known):
        return known.astype(str)
    edges = known.quantile([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]).tolist()
    places = [min(bisect_right(edges[1:3], x), 2) for x in known]
    words = [f"{scale * edges[i]:.0f} to {scale * edges[i + 1]:.0f} {unit}" for i in places]
    return type(known)(words, index=known.index)


# ---------------------------------------------------------------------------------- the loss


def interval_score(lower: Any, upper: Any, truth: Any) -> Any:
    """Width of each 95 % interval, and 40 times the distance by which it misses the truth.

    Parameters
    ----------
    lower, upper, truth
        Ends of the intervals and true values, all of one shape: arrays, or columns of a frame.
    """
    missed = np.maximum(lower - truth, 0.0) + np.maximum(truth - upper, 0.0)
    return upper - lower + MISSED * missed


@lru_cache(maxsize=8)
def _resamples(name: str, count: int) -> FloatArray:
    """Weights of recordings: each once, then drawn with replacement; shape (1 + resamples, count).

    The scenario's name and the number of recordings decide them, whatever else a study holds.
    """
    rng = np.random.default_rng(crc32(name.encode()))
    drawn = rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)
    return np.vstack([np.ones(count), drawn]) / count


def mean_losses(losses: FloatArray, name: str, others: FloatArray | None = None) -> FloatArray:
    """Means and their 95 % intervals, shape (1 + parameters, 3): over all parameters, and of each.

    That over all is the geometric mean over the parameters.

    The intervals are bootstrap-t on logarithms, with recordings as what is resampled.  Misses
    are rare and dear: where few or none came, the recordings do not show how much the loss
    scatters.  It therefore scatters at least as that of an efficient estimator does, one more
    recording like that is added to every resample, and no upper end is nearer than a normal
    distribution has it.

    Parameters
    ----------
    losses
        Shape (recordings, parameters), NaN where a pilot lacks a parameter.
    name
        Of the scenario, which seeds the resampling.
    others
        Those of another method on the same recordings: ratios to its means are given then.
    """
    known = np.isfinite(losses)
    if others is not None:
        known &= np.isfinite(others)
    rows = known.any(axis=1)
    count = int(rows.sum())
    present: BoolArray = np.asarray(known.any(axis=0))
    if not count:
        return np.full((1 + present.size, 3), math.nan)
    known = known[rows][:, present]
    x = np.where(known, losses[rows][:, present], 0.0)
    # Of one method alone the other one's loss is 1 everywhere.
    y = known * 1.0 if others is None else np.where(known, others[rows][:, present], 0.0)
    weights = _resamples(name, count)
    share = weights @ known
    share[share == 0.0] = math.nan  # a resample without any pilot who has the parameter
    means = [weights @ side / share for side in (x, y)]
    with np.errstate(divide="ignore"):  # intervals may have no width
        logs = np.log(means[0] / means[1])
    # What a recording adds to a logarithm is, to first order, (x/mean(x) - y/mean(y))/share.
    squares = weights @ x**2 / means[0] ** 2 + weights @ y**2 / means[1] ** 2
    squares -= 2.0 * (weights @ (x * y)) / (means[0] * means[1])
    together = (x @ (1.0 / (share * means[0])).T - y @ (1.0 / (share * means[1])).T).T
    variance = np.column_stack(
        [np.sum(weights * together**2, axis=1) / present.sum() ** 2, squares / share**2]
    )
    variance *= count / max(count - 1, 1)
    variance[variance < ROUNDING] = 0.0
    if others is None:
        least = np.full(1 + logs.shape[1], EFFICIENT_VARIANCE)
        least[0] /= logs.shape[1]
        variance[0] = np.maximum(variance[0], least)
    logs = np.column_stack([logs.mean(axis=1), logs])
    logs[np.abs(logs) < ROUNDING] = 0.0
    intervals = np.full((1 + present.size, 3), math.nan)
    for place, each_loss, spread in zip(
        np.flatnonzero([True, *present]), logs.T, variance.T, strict=True
    ):
        intervals[place] = _bootstrap_t(each_loss, spread, count, one_sided=others is None)
    return intervals


def _bootstrap_t(
    logs: FloatArray, variance: FloatArray, count: int, *, one_sided: bool
) -> tuple[float, float, float]:
    """An interval from the logarithms of the sample (first) and of its resamples."""
    value = float(np.exp(logs[0]))
    error = math.sqrt(variance[0] / count) if count > 1 and variance[0] >= 0.0 else math.nan
    if not math.isfinite(value) or not math.isfinite(error):
        return value, math.nan, math.nan
    if error == 0.0:
        return value, value, value
    spread = np.sqrt((count * variance[1:] + variance[0]) / (count + 1.0) / count)
    t = (logs[1:] - logs[0]) / spread
    low, high = np.nanquantile(t, [0.025, 0.975]) if np.isfinite(t).any() else (-Z95, Z95)
    if one_sided:
        low = min(low, -Z95)
    return value, value * math.exp(-high * error), value * math.exp(-low * error)


# ---------------------------------------------------------------- one parameter, one true value


def bias(values: FloatArray, truth: float) -> Mean:
    """Mean error, with its sign.

    Parameters
    ----------
    values
        Estimates, shape (fits,).
    truth
        True value, in the same unit.
    """
    if not values.size:
        return Mean(math.nan, math.nan)
    return Mean(float(np.mean(values) - truth), spread(values) / math.sqrt(values.size))


def spread(values: FloatArray) -> float:
    """Sample standard deviation, with n - 1 in the denominator.

    Parameters
    ----------
    values
        Estimates, shape (fits,).
    """
    return float(np.std(values, ddof=1)) if values.size > 1 else math.nan


def rmse(values: FloatArray, truth: float) -> float:
    """Root mean square error.

    Parameters
    ----------
    values
        Estimates, shape (fits,).
    truth
        True value, in the same unit.
    """
    return math.sqrt(float(np.mean((values - truth) ** 2))) if values.size else math.nan


def mean(values: FloatArray) -> float:
    """Mean of the finite entries."""
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if finite.size else math.nan


def geometric_mean(values: Iterable[float]) -> float:
    """Geometric mean of the positive values."""
    logs = [math.log(value) for value in values if value > 0.0]
    return math.exp(float(np.mean(logs))) if logs else math.nan


def skewness(values: FloatArray) -> float:
    """Third moment of the deviations over the cube of their RMS; 0 for equal values."""
    if not values.size:
        return math.nan
    deviations = values - np.mean(values)
    size = rms(deviations)
    return float(np.mean((deviations / size) ** 3)) if size > 0.0 else 0.0


def skewed_t(error: float, deviation: float, skew: float, count: int) -> float:
    """Student's t of a mean, by Hall's transformation, which skewed values need.

    Mean and spread of skewed values, as estimates of a gain are, vary together, which makes the
    plain ratio too large on one side and too small on the other.

    Parameters
    ----------
    error
        Mean less the value that is tested.
    deviation, skew, count
        Standard deviation, which is positive, skewness and number of the values.

    References
    ----------
    P. Hall, *On the removal of skewness by transformation*, J. R. Statist. Soc. B 54(1) 1992.
    """
    share = error / deviation
    corrected = share + skew * share**2 / 3.0 + skew**2 * share**3 / 27.0 + skew / (6.0 * count)
    return math.sqrt(count) * corrected


# ---------------------------------------------------------------------- values of several truths


def clustered_mean(values: FloatArray, clusters: IntArray) -> Mean:
    """Mean of all values, with the standard error of a ratio of sums over clusters.

    Parameters
    ----------
    values
        Shape (values,).
    clusters
        The recording of each, shape (values,).
    """
    if not values.size:
        return Mean(math.nan, math.nan)
    middle = float(np.mean(values))
    # Recordings are numbered from zero; one that has no value here is no cluster.
    sums = np.bincount(clusters, weights=values - middle)[np.bincount(clusters) > 0]
    count = sums.size
    if count < 2:
        return Mean(middle, math.nan)
    return Mean(middle, math.sqrt(float(np.sum(sums**2)) * count / (count - 1)) / values.size)


def root_mean_square(values: FloatArray, clusters: IntArray) -> Mean:
    """Root of the mean square (its error by the delta method)."""
    return _root(clustered_mean(values**2, clusters))


def trimmed(values: FloatArray, clusters: IntArray, share: float = TRIMMED) -> Mean:
    """Root mean square of all but the share of values that are farthest from zero.

    With 1 % left out it is 0.96 for standard normal values.  Of fewer than 1/share values none
    is left out.
    """
    squares = values**2
    if not squares.size:
        return Mean(math.nan, math.nan)
    left_out = math.floor(share * squares.size + 1e-9)
    kept = np.sort(squares)[: squares.size - left_out]
    # The influence of a value that is left out is that of the largest one that is not.
    error = clustered_mean(np.minimum(squares, kept[-1]), clusters).error
    return _root(Mean(float(np.mean(kept)), error * squares.size / kept.size))


def beyond(values: FloatArray, clusters: IntArray, limit: float = FAR_OFF) -> Mean:
    """Share of values farther from zero than a limit."""
    return clustered_mean((np.abs(values) > limit).astype(float), clusters)


def typical(values: FloatArray) -> float:
    """Median of the absolute values, over that of a standard normal variable."""
    return float(np.median(np.abs(values))) / MEDIAN_SIZE if values.size else math.nan


def coverage(hits: BoolArray, clusters: IntArray) -> tuple[Mean, tuple[float, float], int]:
    """Share of intervals that hold the truth, its 95 % interval, and what the values are worth.

    The interval is Wilson's for as many independent intervals as the clusters are worth: as
    many as there are clusters if all or none hold the truth, where they tell no error.

    Parameters
    ----------
    hits
        Whether each interval holds the truth, shape (values,).
    clusters
        The recording of each, shape (values,).
    """
    share = clustered_mean(hits.astype(float), clusters)
    if not hits.size:
        return share, (math.nan, math.nan), 0
    worth = int(np.count_nonzero(np.bincount(clusters)))
    if worth < hits.size and share.error > 0.0:
        # Parameters that make up for one another are worth no more than independent ones.
        worth = min(hits.size, max(1, round(share.value * (1.0 - share.value) / share.error**2)))
    return share, coverage_interval(share.value, worth), worth


def coverage_interval(share: float, count: int) -> tuple[float, float]:
    """95 % interval of the coverage that an observed share of `count` intervals tells (Wilson).

    Parameters
    ----------
    share
        Share of the intervals that held the truth.
    count
        Number of intervals, at least one.
    """
    z = Z95
    centre = (share + z**2 / (2 * count)) / (1.0 + z**2 / count)
    reach = z * math.sqrt(share * (1.0 - share) / count + z**2 / (4 * count**2))
    return centre - reach / (1.0 + z**2 / count), centre + reach / (1.0 + z**2 / count)


def _root(square: Mean) -> Mean:
    root = math.sqrt(square.value) if square.value >= 0.0 else math.nan
    return Mean(root, square.error / (2.0 * root) if root > 0.0 else math.nan)
