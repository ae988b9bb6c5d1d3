"""The table of a study: what a store keeps of each fit, all of it as one frame, and verdicts.

No verdict depends on what else a study or a report holds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pilotid.study.scores import ALL, LOSS, loss_ratios, measured, score, skewed_t
from pilotid.support.disk import frame_bytes, write_file
from pilotid.support.format import number, signed
from pilotid.support.store import Key, Rows
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

#: Facts on the draw of a population by which its recordings are divided: words, and numbers.
WORDS = ("element", "remnant", "forcing")
NUMBERS = ("remnant_level", "dt", "duration", "run_in", "runs")
#: Columns of estimates.csv, as the frame calls them.
ESTIMATES = {
    **{n: n for n in ("scenario", "method", "replication", "outcome", "parameter", "truth")},
    **{"value": "value", "std_error": "std_error", "lower": "lower_95", "upper": "upper_95"},
    **{"seconds": "seconds", "bound": "crlb", "determined": "determined"},
}
#: Columns of summary.csv.
SUMMARY = [
    *("scenario", "method", "parameter", "n", "failures", "truth", "bias", "bias_se"),
    *("bias_percent", "std", "rmse", "crlb", "mean_std_error", "coverage_95", "posterior_std"),
    *LOSS,
]
#: Columns of population.csv.
POPULATION = [
    *("scenario", "method", "stratum", "value", "parameter", "recordings", "n"),
    *("coverage_95", "coverage_se", "mean_z", "mean_z_se", "rms_z", "rms_z_se"),
    *("rms_z_trimmed", "rms_z_trimmed_se", "beyond_3", "beyond_3_se"),
    *("rmse_over_bound", "rmse_over_bound_se", "median_over_bound"),
    *("failures", "not_applicable", "wrong_optima", "optima", *LOSS),
]
#: Which rows of a store are scenarios, methods and fits; that without names has the facts.
OF_SCENARIOS = "scenario != '' AND method = ''"
OF_METHODS = "scenario = '' AND method != ''"
OF_FITS = "scenario != '' AND method != ''"
OF_CELL = "scenario = ? AND method = ?"

#: Parameter, unit, true value, Cramer-Rao bound, value, standard error, ends of the interval.
Estimated = tuple[
    str, str, float | None, float | None, float | None, float | None, float | None, float | None
]


@dataclass(frozen=True)
class Fit:
    """What a fit gave; numbers are None where there are none.

    Attributes
    ----------
    scenario, method, replication
        What was fitted: name of the scenario, label of the method, which recording, from 0.
    outcome, message, usable
        How it ended, and whether the estimate counts.
    vaf, iterations, seconds
        See `pilotid.estimate.estimate.Estimate`.
    posterior
        Whether the standard errors are those of a posterior distribution.
    excess
        Of a fit to a recording of a population: the criterion over that of a search which
        starts at the truth, where the method has a ``criteria_from`` as `MLE` does.
    remarks
        What a user would have been told of the recording and of the estimate, on one line, see
        `pilotid.study.run.told`; empty for nothing.
    model, facts
        The pilot's model, empty where it is not known what was drawn; of a population, words and
        numbers on element, forcing, remnant and length, see `pilotid.study.run.facts_of`.
    estimates
        For each parameter key, unit, true value, bound on the standard deviation, value, standard
        error, and the ends of the interval.
    undetermined
        Keys of parameters that the recording does not determine, see
        `pilotid.estimate.quantities.Quantity`.
    """

    scenario: str
    method: str
    replication: int
    outcome: str
    message: str = ""
    usable: bool = False
    vaf: float | None = None
    iterations: int = 0
    seconds: float | None = None
    posterior: bool = False
    excess: float | None = None
    remarks: str = ""
    model: str = ""
    facts: Mapping[str, str | float] = field(default_factory=dict)
    estimates: tuple[Estimated, ...] = ()
    undetermined: tuple[str, ...] = ()

    @property
    def key(self) -> Key:
        """What tells it from others."""
        return self.scenario, self.method, self.replication


@dataclass(frozen=True)
class Entry:
    """A scenario or a method as the store knows it.

    Attributes
    ----------
    name
        Name of the scenario, or label of the method.
    position
        Its place in tables and figures.
    settings, code
        All that defines it, as plain objects, and a digest of code of the user's own.
    typed
        What to type for it.
    description, model, family, population
        Of a scenario: what it is, names of its models, the family of scenarios that it belongs
        to, and whether every replication has a pilot of its own.
    remnant
        The remnant's share of the control's power, None where that is not known.
    """

    name: str
    position: int
    settings: Mapping[str, Any]
    code: str = ""
    typed: str = ""
    description: str = ""
    model: str = ""
    family: str = ""
    population: bool = False
    remnant: float | None = None

    @property
    def uses_prior(self) -> bool:
        """Whether a method uses prior knowledge of pilots."""
        return "prior" in self.settings

    @property
    def one_recording(self) -> bool:
        """Whether all fits are of the same recording, so that means say nothing."""
        return self.settings.get("one_recording") is True


class Store(Rows):
    """A study's rows in a folder; what is known already stays as it is."""

    format = 9

    def describe(self, about: Mapping[str, str]) -> None:
        """Keep facts on the study."""
        self.put(("", "", 0), {**self.about(), **about}, again=True)

    def about(self) -> dict[str, str]:
        """Facts on the study."""
        facts: dict[str, str] = self.get(dict[str, str], ("", "", 0)) or {}
        return dict(sorted(facts.items()))

    def enter(self, scenarios: Iterable[Entry] = (), methods: Iterable[Entry] = ()) -> None:
        """Keep what scenarios and methods are."""
        for entry in scenarios:
            self.put((entry.name, "", 0), asdict(entry))
        for entry in methods:
            self.put(("", entry.name, 0), asdict(entry))

    def entries(self, which: str) -> dict[str, Entry]:
        """Scenarios (`OF_SCENARIOS`) or methods (`OF_METHODS`) by name, in their order."""
        ordered = sorted(self.every(Entry, which), key=lambda entry: (entry.position, entry.name))
        return {entry.name: entry for entry in ordered}

    def add(self, fit: Fit) -> None:
        """Keep a fit."""
        self.put(fit.key, asdict(fit))

    def fits(self) -> list[Fit]:
        """All fits, in the order of their keys."""
        return self.every(Fit, OF_FITS)

    def comparison(self) -> Comparison:
        """All that it holds; fits of scenarios and methods that it does not know are left out."""
        from pandas import concat

        scenarios, methods = self.entries(OF_SCENARIOS), self.entries(OF_METHODS)
        cells = (self.every(Fit, OF_CELL, *pair) for pair in product(scenarios, methods))
        frame = concat([frame_of(cell) for cell in cells if cell] or [frame_of([])])
        frame = frame.reset_index(drop=True)
        frame["population"] = frame.scenario.map({n: e.population for n, e in scenarios.items()})
        present = set(frame.scenario), set(frame.method)
        return Comparison(
            frame,
            {name: entry for name, entry in scenarios.items() if name in present[0]},
            {name: entry for name, entry in methods.items() if name in present[1]},
            self.about(),
            self.path.parent,
        )


#: Columns of a frame that are the same for all parameters of a fit, and those that are not.
OF_FIT = (
    *("scenario", "method", "replication", "outcome", "message", "usable", "posterior"),
    *("seconds", "excess", "remarks", "model"),
)
OF_PARAMETER = ("parameter", "unit", "truth", "bound", "value", "std_error", "lower", "upper")


def frame_of(fits: Iterable[Fit]) -> DataFrame:
    """Fits as a frame: a row for each parameter of each.

    A fit of which it is not known what was drawn has one row, whose parameter is empty.
    """
    from pandas import DataFrame, to_numeric

    columns = (*OF_FIT, *WORDS, *NUMBERS, *OF_PARAMETER, "determined")
    nothing = (("", "", *(None,) * 6),)

    def rows() -> Iterator[tuple[Any, ...]]:
        for fit in fits:
            of_fit = tuple(getattr(fit, name) for name in OF_FIT)
            drawn = tuple(fit.facts.get(name) for name in (*WORDS, *NUMBERS))
            for known in fit.estimates or nothing:
                yield *of_fit, *drawn, *known, known[0] not in fit.undetermined

    frame = DataFrame(list(rows()), columns=columns)
    for name in (*NUMBERS, "seconds", "excess", *OF_PARAMETER[2:]):
        numbers = to_numeric(frame[name], errors="coerce").astype(float)
        frame[name] = numbers.where(np.isfinite(numbers))
    frame["bound"] = frame.bound.where(frame.bound != 0.0)
    frame["determined"] &= frame.value.notna()
    return frame.drop_duplicates(["scenario", "method", "replication", "parameter"])


@dataclass(frozen=True, eq=False)
class Comparison:
    """All fits of a study as a tidy frame, and what its scenarios and methods are.

    Attributes
    ----------
    frame
        A row for each scenario, method, replication and parameter: ``outcome``, ``message``,
        ``usable``, ``posterior``, ``seconds``, ``excess``, ``remarks``, ``model``, facts on the
        draw of a population, ``parameter``, ``unit``, ``truth``, ``bound``, ``value``,
        ``std_error``, ``lower``, ``upper``, ``determined``; see `Fit`.
    scenarios, methods
        Those that have fits, by name or label, in the order of tables and figures.
    about
        Seed, code and versions.
    folder
        Where its store is.
    """

    frame: DataFrame = field(repr=False)
    scenarios: Mapping[str, Entry]
    methods: Mapping[str, Entry]
    about: Mapping[str, str]
    folder: Path
    # Each takes a bootstrap, and sentences and tables show the same ones.
    _ratios: dict[tuple[str, str, str], tuple[float, float, float]] = field(
        default_factory=dict, init=False, repr=False
    )

    @cached_property
    def measured(self) -> DataFrame:
        """The frame with what scores are made of, see `pilotid.study.scores.measured`."""
        return measured(self.frame)

    @cached_property
    def scores(self) -> DataFrame:
        """Scores of all parameters and of each, see `pilotid.study.scores.score`."""
        return score(self.measured)

    @cached_property
    def _cells(self) -> dict[tuple[str, str], tuple[DataFrame, DataFrame]]:
        by = ["scenario", "method"]
        whole = self.scores[self.scores.stratum == ALL]
        cells, of = (dict(iter(d.groupby(by, sort=False))) for d in (self.measured, whole))
        return {cell: (cells[cell], of[cell]) for cell in cells}

    def cell(self, scenario: str, method: str) -> DataFrame:
        """The rows of `measured` of a method in a scenario; none if it was not tried there.

        Parameters
        ----------
        scenario, method
            Name of the scenario, label of the method.
        """
        return self._cells.get((scenario, method), (self.measured[:0],))[0]

    def scored(self, scenario: str, method: str) -> DataFrame:
        """Scores of a method over all recordings of a scenario, those of all parameters first.

        Parameters
        ----------
        scenario, method
            Name of the scenario, label of the method.
        """
        return self._cells.get((scenario, method), (self.scores[:0],))[-1]

    def ratio(self, scenario: str, method: str, other: str) -> tuple[float, float, float]:
        """Ratio of a method's loss to another's on the same recordings, and its 95 % interval.

        Parameters
        ----------
        scenario, method, other
            Name of the scenario, labels of the methods.
        """
        key = scenario, method, other
        if key not in self._ratios:
            cells = self.cell(scenario, method), self.cell(scenario, other)
            self._ratios[key] = tuple(loss_ratios(*cells).loc[ALL, list(LOSS)])
        return self._ratios[key]

    def of(self, scenario: str) -> DataFrame:
        """Scores over all parameters and recordings of a scenario, a row for each method."""
        s = self.scores
        rows = s[(s.scenario == scenario) & (s.stratum == ALL) & (s.parameter == ALL)]
        return rows.set_index("method", drop=False)

    def replications(self, scenario: str | None = None) -> int:
        """Recordings of a scenario, or of that which has most."""
        frame = self.frame if scenario is None else self.frame[self.frame.scenario == scenario]
        return int(frame.replication.max()) + 1 if len(frame) else 0

    def to_dataframe(self, *, summary: bool = False) -> DataFrame:
        """All estimates, or the scores, as estimates.csv and summary.csv have them.

        Parameters
        ----------
        summary
            A row for each scenario, method and parameter in place of one for each fit.
        """
        if not summary:
            return self.frame[list(ESTIMATES)].rename(columns=ESTIMATES)
        rows = self.scores[self.scores.stratum == ALL]
        every = rows.parameter == ALL
        rows = rows.assign(
            n=rows.n.where(~every, rows.usable), failures=rows.failures + rows.not_applicable
        )
        # All parameters together stand behind each.
        cell = rows.groupby(["scenario", "method"], sort=False).ngroup()
        order = rows.assign(cell=cell, every=every).sort_values(["cell", "every"], kind="stable")
        return order[SUMMARY].reset_index(drop=True)

    def write(self, folder: Path) -> None:
        """Write estimates and scores as CSV, numbers with as many digits as restore them.

        scores.csv has all scores; summary.csv and population.csv, if there is a population, the
        commonest of them.
        """
        scores = self.scores.astype({"wrong_optima": object})
        # Where no optimum is known, nobody can say how many are wrong.
        scores["wrong_optima"] = scores.wrong_optima.where(scores.optima > 0)
        drawn = scores.scenario.map({name: e.population for name, e in self.scenarios.items()})
        tables = {
            "summary.csv": self.to_dataframe(summary=True),
            "estimates.csv": self.to_dataframe(),
            "scores.csv": scores[POPULATION],
            "population.csv": scores.loc[drawn, POPULATION],
        }
        for name, table in tables.items():
            if len(table) or name != "population.csv":
                write_file(folder / name, frame_bytes(table))


def read_study(folder: Path) -> Comparison:
    """The study that `pilotid compare` wrote to a folder."""
    with Store(folder) as store:
        return store.comparison()


# ---------------------------------------------------------------------------- two studies


def find_changes(first: Comparison, second: Comparison) -> tuple[DataFrame, list[str]]:
    """Ratios of losses on the recordings that both studies have, and what is left out.

    Parameters
    ----------
    first, second
        The studies, in this order; the bounds of the first count.

    Returns
    -------
    Scenario, method, parameter, and the loss in the second study over that in the first with its
    95 % interval; and a sentence on each scenario that is left out.

    Raises
    ------
    InputError
        If the studies have no recordings in common.
    """
    from pandas import concat

    seeds = [study.about.get("seed", "?") for study in (first, second)]
    if seeds[0] != seeds[1]:
        raise InputError(
            f"{second.folder}: has the seed {seeds[1]} and other recordings than {first.folder} "
            f"(seed {seeds[0]}); set the columns `loss` of both summary.csv side by side"
        )
    changes, unlike = [], {}
    for name, method in dict.fromkeys(zip(first.frame.scenario, first.frame.method, strict=True)):
        ours, theirs = first.cell(name, method), second.cell(name, method)
        if not len(theirs):
            continue
        if first.scenarios[name].settings != second.scenarios[name].settings:
            unlike[name] = f"{name} is left out: its settings differ"
        elif not _same_pilots(ours, theirs):
            unlike[name] = f"{name} is left out: other pilots were drawn"
        else:
            ratios = loss_ratios(theirs, ours).rename_axis("parameter").reset_index()
            changes.append(ratios.assign(scenario=name, method=method))
    if not changes:
        why = "; ".join(["", *unlike.values()])
        raise InputError(f"{second.folder}: lacks recordings or methods of {first.folder}{why}")
    return concat(changes)[["scenario", "method", "parameter", *LOSS]], list(unlike.values())


def _same_pilots(ours: DataFrame, theirs: DataFrame) -> bool:
    """Whether recordings have the same pilots, but for the rounding of different processors."""
    known = [side[side.model != ""] for side in (ours, theirs)]
    shared = set(known[0].replication) & set(known[1].replication)
    a, b = (side[side.replication.isin(shared)].reset_index() for side in known)
    columns = ["replication", "parameter", "model"]
    return a[columns].equals(b[columns]) and np.allclose(a.truth, b.truth, rtol=1e-6, atol=0.0)


# ------------------------------------------------- what is to be thought of a method in a scenario


#: Loss of all parameters below which a method is efficient, and below which it is usable.
EFFICIENT, USABLE = 1.25, 2.0
#: Root mean square error over the bound of an efficient method's worst parameter, at the most.
USELESS = 4.0
#: A flag stands for what chance shows this seldom in a method that has no such fault.
CHANCE = 1e-3
#: Share of failed fits that is no fault, and the one beyond which a method is poor.
FAILURES, MOST_FAILURES = 0.01, 0.1
FITS_TO_TEST = 5  # fits of which a mean can be tested
#: What verdicts rest on, for those who explain them.
LIMITS = {
    "efficient": EFFICIENT,
    "usable": USABLE,
    "useless": USELESS,
    "without": round(1.0 / CHANCE),
    "failing": 100.0 * FAILURES,
    "often": 100.0 * MOST_FAILURES,
}


class Flag(NamedTuple):
    """A fault that is certain.

    Attributes
    ----------
    code
        ``biased``, ``too-short``, ``too-long`` or ``fails``.
    parameter
        The parameter where it is worst; of failures all.
    value
        Mean error over claimed error, coverage, or share of failures.
    """

    code: str
    parameter: str
    value: float

    @property
    def words(self) -> str:
        """What the fault is called in a table."""
        fault = self.code.replace("-", " ")
        name = f"intervals {fault}" if self.code.startswith("too-") else fault
        return name if self.parameter == ALL else f"{name} ({self.parameter})"


@dataclass(frozen=True)
class Verdict:
    """What is to be thought of a method in a scenario.

    Attributes
    ----------
    grade
        ``efficient``, ``usable`` or ``poor`` by the loss; ``unscored`` without intervals, or
        ``not applicable``.
    flags
        Faults that are certain.
    """

    grade: str
    flags: tuple[Flag, ...]

    @property
    def words(self) -> str:
        """The grade with the flags."""
        faults = ", ".join(flag.words for flag in self.flags)
        return f"{self.grade}: {faults}" if faults else self.grade


def judge(scores: DataFrame) -> Verdict:
    """Judge a method in a scenario.

    Parameters
    ----------
    scores
        Of all parameters together, and of each; see `pilotid.study.scores.score`.
    """
    rows = list(scores.itertuples())
    overall = rows[0]
    if not overall.recordings:
        return Verdict("not applicable", ())
    grade = "poor"
    if math.isnan(overall.loss):
        grade = "unscored"
    elif overall.loss < USABLE and not fails_often(overall):
        even = not scores.iloc[1:].rmse_over_bound.max() > USELESS
        grade = "efficient" if overall.loss < EFFICIENT and even else "usable"
    flags = (_bias(rows[1:]), _coverage(rows), _failures(overall))
    return Verdict(grade, tuple(flag for flag in flags if flag))


def fails_often(row: Any) -> bool:
    """Whether more than a tenth of the fits failed, of which a row of scores tells."""
    return bool(row.failures > MOST_FAILURES * row.recordings)


def is_ranked(row: Any) -> bool:
    """Whether a method has a loss that ranks it: that of one that fails often does not."""
    return math.isfinite(row.loss) and not fails_often(row)


def _bias(each: list[Any]) -> Flag | None:
    """The largest certain bias, by a t test that allows for skewed errors."""
    from scipy.special import stdtr

    def certain(s: Any) -> bool:
        if s.n < FITS_TO_TEST or not s.mean_z_se > 0.0:
            return False
        t = skewed_t(s.mean_z, s.mean_z_se * math.sqrt(s.n), s.z_skew, s.n)
        return bool(2.0 * stdtr(s.n - 1.0, -abs(t)) < CHANCE)

    worst = max(filter(certain, each), key=lambda s: abs(s.mean_z), default=None)
    return Flag("biased", worst.parameter, worst.mean_z) if worst else None


def _coverage(rows: list[Any]) -> Flag | None:
    """The coverage that is surest not to be 95 %, by the binomial distribution."""
    from scipy.special import bdtr, bdtrc

    outside = []
    for s in rows:
        if not s.worth:
            continue
        hits = s.coverage_95 * s.worth
        short = float(bdtr(math.floor(hits + 1e-9), s.worth, 0.95))
        long = float(bdtrc(math.ceil(hits - 1e-9) - 1, s.worth, 0.95)) if hits > 0.0 else 1.0
        if 2.0 * min(short, long) < CHANCE:
            outside.append((s, "too-short" if short < long else "too-long"))
    if not outside:
        return None
    single = [f for f in outside if f[0].parameter != ALL] or outside
    worst, code = max(single, key=lambda f: abs(f[0].coverage_95 - 0.95))
    return Flag(code, worst.parameter, worst.coverage_95)


def _failures(overall: Any) -> Flag | None:
    """Failures that are certainly more than a few."""
    from scipy.special import bdtrc

    count, share = overall.recordings, overall.failures / overall.recordings
    if not overall.failures or bdtrc(overall.failures - 1, count, FAILURES) >= CHANCE:
        return None
    return Flag("fails", ALL, share)


def worst_parameter(scores: DataFrame) -> str:
    """The parameter that is farthest off in bounds, in rmse, and its bias; empty for none."""
    rows = scores.iloc[1:].dropna(subset="rmse_over_bound")
    if not len(rows):
        return ""
    row = rows.loc[rows.rmse_over_bound.idxmax()]
    words = f"{row.parameter} {number(row.rmse_over_bound, 2)} bounds"
    known = math.isfinite(row.bias_percent)
    return f"{words}, {signed(row.bias_percent)} %" if known else words
