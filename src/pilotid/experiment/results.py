"""What is asked of an experiment, and the tidy frames of what came out.

What is not determined does not count: an estimate at a bound, one whose interval spans more than a
factor of ten, one of a fit that failed or is graded wrong, as where the lines of the forcing
functions contradict it, and all of a recording that is graded wrong.  The column
``left_out`` says why, and is empty where a value counts.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, product
from typing import Any

from pandas import DataFrame

from pilotid.estimate.method import Method
from pilotid.experiment.comparisons import CONTRAST, EFFECT, contrasts, effects
from pilotid.experiment.files import Part, in_order
from pilotid.likelihood.choice import Candidate, Choice, choose_jointly, choose_model
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.recording.files import Reading
from pilotid.support.remarks import Remark

#: Recordings for which one model is chosen.
Group = tuple[str, ...]
#: What a task gives back: plain objects, as JSON has them.
Content = dict[str, Any]
#: Kinds of quantities: of signals, which need no model; of loops, which mean the same in every
#: model; and a model's parameters.
KINDS = ("measured", "loop", "parameter")
RESPONSES = ("stratum", "condition", "channel", "omega", "real", "imag", "std")
COMPARED = ("test", "kind", "comparison", "family", "model_suits", "group", "model")


@dataclass(frozen=True, eq=False)
class Fitting:
    """How every recording is fitted.

    Attributes
    ----------
    methods
        Methods by their labels.
    element
        The controlled element, where the user names it.
    seed
        Seed of all random numbers.
    reading
        How files are read.
    per_run, left_out
        Whether every run is fitted on its own as well, and predicted by the fit of the others.
    sensitivity
        Whether each recording is fitted in other ways as well.
    """

    methods: Mapping[str, Method]
    element: ControlledElement | None = None
    seed: int = 0
    reading: Reading = field(default_factory=Reading)
    per_run: bool = False
    left_out: bool = False
    sensitivity: bool = False


@dataclass(frozen=True, eq=False)
class Settings:
    """What is asked of an experiment.

    Attributes
    ----------
    fitting
        How every recording is fitted.
    models
        All models that may be fitted, by name.
    named
        Names of those that the user named; if none, the catalogue's sensible models compete, and
        the best is fitted.
    pairs
        What the user contrasts; conditions that differ in one factor if nothing.
    factors
        Level of each factor (columns) by condition; empty for no factors.
    keep_all
        Whether estimates that are not determined, or wrong, count as well.
    """

    fitting: Fitting
    models: Mapping[str, PilotModel]
    named: Sequence[str]
    pairs: Sequence[tuple[str, str]] = ()
    factors: DataFrame = field(default_factory=DataFrame)
    keep_all: bool = False

    def tests(self, conditions: Collection[str]) -> list[tuple[str, Group]]:
        """The tests of some conditions, and which conditions each compares."""
        levels, every = self.factors.T, tuple(self.factors.index)
        pairs = self.pairs or [
            (a, b)
            for a, b in combinations(in_order(conditions), 2)
            if not every or (a in every and b in every and (levels[a] != levels[b]).sum() == 1)
        ]
        tests = [(CONTRAST, pair) for pair in pairs] + ([(EFFECT, every)] if every else [])
        return [(test, some) for test, some in tests if {*some} <= {*conditions}]


@dataclass(frozen=True, eq=False)
class Results:
    """What came out of an experiment, and the frames that tables, figures and report show.

    Attributes
    ----------
    settings
        What was asked for.
    looks, fitted
        What the tasks gave: of each recording that could be read, and of each fit.
    choices
        The model chosen for each group of recordings, see `Part.group`.
    compared
        In which models conditions are compared, see `choices_of`.
    refused
        A sentence for each file or fit that there is not.
    """

    settings: Settings
    looks: Mapping[Part, Content]
    choices: Mapping[Group, Choice]
    compared: DataFrame
    fitted: Sequence[tuple[Part, Content]]
    refused: Sequence[str]

    @property
    def strata(self) -> list[str]:
        """Fields of the pattern within whose values conditions are compared."""
        fields = next(iter(self.looks)).fields
        return [name for name in fields if name not in ("subject", "condition")]

    @cached_property
    def quantities(self) -> DataFrame:
        """A row for each quantity of each fit.

        Columns: file, the pattern's fields, `QUANTITY_COLUMNS`, the controlled element, kind (see
        `KINDS`), ``left_out``, ``otherwise`` (the other way in which it was fitted), ``chosen``
        (whether the model is that of the recording's own table), the recording in words and its
        group, its number of runs, the fit's VAF, all `Remark`s on recording and fit (``said``), and
        why a fit failed (``failure``), empty if it did not.
        """
        rows, settings = list[Content](), self.settings
        for part, content in (*self.looks.items(), *self.fitted):
            seen, choice = self.looks[part], self.choices[part.group].model
            head = {"file": part.name, **part.fields, "group": part.group}
            head |= {"recording": part.words, "runs": seen["runs"]}
            for row in content["rows"]:
                if row["run"] is None or settings.fitting.per_run:
                    chosen = bool(settings.named) or row["model"] in ("", choice)
                    judged = _judged(settings, seen["remarks"], row)
                    rows.append({**head, **row, **judged, "chosen": chosen})
        return DataFrame(rows).astype({"run": "Int64"})

    @property
    def usual(self) -> DataFrame:
        """Quantities of all runs together, fitted as was asked for and in no other way."""
        rows = self.quantities
        return rows[rows["run"].isna() & (rows["otherwise"] == "")]

    @cached_property
    def models(self) -> DataFrame:
        """Rows of models.csv."""
        frame = DataFrame(
            {"file": part.name, **part.fields, "model": "", "chosen": "no", **candidate}
            | ({"chosen": "yes"} if candidate["model"] == self.choices[part.group].model else {})
            for part, content in self.looks.items()
            for candidate in content["candidates"]
        ).drop(columns=["no_delay", "determined", "varies"])
        frame["freedom"] = frame["freedom"].where(frame["freedom"] > 0).astype("Int64")
        of_runs = ["left_out_log_likelihood", "left_out_chi_squared"]
        frame[of_runs] = frame[of_runs].map(lambda runs: sum(runs) or math.nan)
        return frame.rename(columns={"bounds": "remarks"})

    @cached_property
    def left_out(self) -> DataFrame:
        """Rows of left_out.csv."""
        return DataFrame(
            {"file": part.name, **part.fields, **row}
            for part, content in self.fitted
            for row in content.get("left_out", ())
        )

    @property
    def responses(self) -> DataFrame:
        """Coefficients at the forcing lines of the recordings that count."""
        settings, first = self.settings, dict(reversed(self.fitted))
        rows = [
            {"stratum": " ".join(part.stratum), "condition": part.condition, **row}
            for part, seen in self.looks.items()
            if settings.keep_all
            or "wrong" not in {remark.grade for remark in _remarks(seen["remarks"])}
            for row in first.get(part, {}).get("responses", ())
        ]
        return DataFrame(rows, columns=RESPONSES)

    def groups(self) -> Iterator[tuple[str, DataFrame]]:
        """Quantities of all runs together by the model of each recording, a table each.

        A table is of one stratum and method, and of one model if models were named.
        """
        keys = [*self.strata, "method", *(["model"] if self.settings.named else [])]
        for key, rows in self.usual[self.usual["chosen"]].groupby(keys, sort=False):
            yield ", ".join(filter(None, key)), rows

    @cached_property
    def cells(self) -> DataFrame:
        """What `compared` asks for, with the value of each subject; NaN where it does not count."""
        rows = self.usual[~self.usual["parameter"].str.startswith("rms_")]
        rows = rows.assign(value=rows["value"].where(rows["left_out"] == ""))
        return self.compared.merge(rows, on=["kind", "group", "model"])

    @cached_property
    def contrasts(self) -> DataFrame:
        """Differences between conditions, rows of contrasts.csv."""
        return contrasts(self.cells, self.strata)

    @cached_property
    def factors(self) -> DataFrame:
        """Effects of the factors, rows of factors.csv."""
        return effects(self.cells, self.strata, self.settings.factors)


def choices_of(
    looks: Mapping[Part, Content], settings: Settings
) -> tuple[dict[Group, Choice], DataFrame]:
    """The model of each group of recordings, and in which models conditions are compared.

    Of the second there is a row for each condition of each comparison: its ``test``, the ``kind``
    of quantities, what tells it from others; the ``family`` of comparisons that Holm's correction
    is for; whether the models suit all its conditions (``model_suits``); and ``group`` and
    ``model``, which is empty if there is none to compare in.
    """
    groups: dict[Group, list[list[Candidate]]] = {}
    strata: dict[Group, dict[str, Group]] = {}
    for part, content in looks.items():
        candidates = [Candidate(**candidate) for candidate in content["candidates"]]
        groups.setdefault(part.group, []).append(candidates)
        strata.setdefault(part.stratum, {})[part.condition] = part.group
    choices = {group: choose_model(candidates) for group, candidates in groups.items()}
    rows = list[tuple[Any, ...]]()
    for there in strata.values():
        here = list[tuple[Any, ...]]()
        for test, conditions in settings.tests(there):
            ways = [("measured", "", dict[str, str](), True)]
            for kind, name in product(KINDS[1:], settings.named):
                ways.append((kind, name, dict.fromkeys(conditions, name), True))
            if not settings.named:
                some = {condition: groups[there[condition]] for condition in conditions}
                models, suits = choose_jointly(some, settings.models)
                # Of many conditions a model that does not suit them all serves no test.
                models = models if suits or len(some) == 2 else {}
                # Crossover and margin mean the same in any model.
                own = {condition: choices[there[condition]].model for condition in conditions}
                ways += [("loop", "", own, True), ("parameter", "", models, suits)]
            for kind, family, models, suits in ways:
                what = test, kind, (family, *map(there.get, conditions)), family, suits
                here += [(*what, there[c], models.get(c, "")) for c in conditions]
        rows += sorted(here, key=lambda row: KINDS.index(row[1]))
    return choices, DataFrame(rows, columns=COMPARED)


def _judged(settings: Settings, of_recording: Iterable[Sequence[str]], row: Content) -> Content:
    """What is said of a value and its recording, and why it does not count; empty if it does."""
    said = _remarks([*of_recording, *row["of_fit"]])
    of_loops = _remarks(row["of_loops"])
    unusable = [] if row["usable"] else [row["outcome"]]
    wrong = [remark.code for remark in [*said, *of_loops] if remark.grade == "wrong"]
    doubted = [] if settings.keep_all else [*wrong, row["left_out"]]
    no_value = [] if math.isfinite(row["value"]) else ["no value"]
    why = next(filter(None, [*unusable, *doubted, *no_value]), "")
    about = of_loops if row["kind"] == "loop" else _remarks(row["of_fit"])
    words = [f"not counted: {row['failure'] or why}"] if why else []
    return {"left_out": why, "said": said, "remarks": " | ".join([*words, *about])}


def _remarks(found: Iterable[Sequence[str]]) -> list[Remark]:
    """Remarks from what `Content` has of them, each once."""
    return [*dict.fromkeys(Remark(*remark) for remark in found)]  # type: ignore[arg-type]
