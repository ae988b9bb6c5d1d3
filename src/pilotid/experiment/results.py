"""What is asked of an experiment, and the tidy frames of what came out.

What is not determined does not count: an estimate at a bound, one whose interval spans more than a
factor of ten, one of a fit that failed or is graded wrong, as where the lines of the forcing
functions contradict it, and all of a recording that is graded wrong.  `LEFT_OUT` says why.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Any

from pilotid.estimate.method import Method
from pilotid.experiment.files import CONDITION, SUBJECT, Part, in_order
from pilotid.likelihood.choice import Candidate, Choice, choose_jointly, choose_model
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.recording.files import Reading
from pilotid.support.remarks import Remark

if TYPE_CHECKING:
    from pandas import DataFrame

#: Kinds of quantities: of signals, which need no model; of loops, which mean the same in every
#: model; and a model's parameters.
MEASURED, LOOP, PARAMETER = KINDS = ("measured", "loop", "parameter")
#: Why a value enters no mean, test or figure; empty if it does.
LEFT_OUT = "left_out"
LEFT_OUT_COLUMNS = ("run", "model", "method", "outcome", "vaf", "log_likelihood", "seconds")
#: Recordings for which one model is chosen, or conditions that are compared.
Group = tuple[str, ...]
#: By stratum and conditions, the models in which these are compared, by condition, and whether
#: they suit all; empty where all models were named.
Compared = Mapping[tuple[Group, Group], tuple[Mapping[str, str], bool]]
#: What a task gives back: plain objects, as JSON has them.
Content = dict[str, Any]


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
        Names of those that the user named.
    auto
        Whether the catalogue's sensible models compete with them, and the best is fitted.
    pairs
        What the user contrasts; conditions that differ in one factor if nothing.
    factors
        Level of each factor (columns) by condition; None for no factors.
    keep_all
        Whether estimates that are not determined, or wrong, count as well.
    excluded
        Recordings that the user leaves out.
    ignored
        Codes of remarks that the user does not want to see.
    """

    fitting: Fitting
    models: Mapping[str, PilotModel]
    named: Sequence[str]
    auto: bool
    pairs: Sequence[tuple[str, str]] = ()
    factors: DataFrame | None = None
    keep_all: bool = False
    excluded: Sequence[Part] = ()
    ignored: frozenset[str] = frozenset()

    def condition_pairs(self, conditions: Sequence[str]) -> list[tuple[str, str]]:
        """The pairs of conditions that are contrasted."""
        if self.pairs:
            return [pair for pair in self.pairs if set(pair) <= set(conditions)]
        every = list(combinations(in_order(conditions), 2))
        if self.factors is None:
            return every
        levels = self.factors
        known = [(a, b) for a, b in every if {a, b} <= {*levels.index}]
        return [(a, b) for a, b in known if (levels.loc[a] != levels.loc[b]).sum() == 1]

    def crossed(self, conditions: Sequence[str]) -> list[Group]:
        """All conditions that the factors cross, if they are among these."""
        every = () if self.factors is None else tuple(self.factors.index)
        return [every] if every and {*every} <= {*conditions} else []


@dataclass(frozen=True, eq=False)
class Results:
    """All that tables, figures and report show.

    Attributes
    ----------
    settings
        What was asked for.
    parts
        The recordings that could be read.
    choices
        The model chosen for each group of recordings, see `Part.group`.
    compared
        The models in which conditions are compared, see `Compared`.
    quantities
        A row for each quantity of each fit: file, the pattern's fields, `QUANTITY_COLUMNS`, the
        controlled element, kind, `LEFT_OUT`, ``otherwise`` (the other way in which it was fitted),
        ``chosen`` (whether the model is that of the recording's own table), the recording in words,
        its number of runs, the fit's VAF and all `Remark`s on recording and fit (``said``).
    models, left_out
        Rows of models.csv and of left_out.csv.
    responses
        Coefficients at the forcing lines of the recordings that count.
    contrasts, factors
        Differences between conditions and effects of factors, see `comparisons`; empty at first.
    refused
        A sentence for each file or fit that there is not.
    """

    settings: Settings
    parts: Sequence[Part]
    choices: Mapping[Group, Choice]
    compared: Compared
    quantities: DataFrame
    models: DataFrame
    left_out: DataFrame
    responses: DataFrame
    contrasts: DataFrame
    factors: DataFrame
    refused: Sequence[str]

    @property
    def fields(self) -> list[str]:
        """The fields of the pattern."""
        return [*self.parts[0].fields]

    @property
    def strata(self) -> list[str]:
        """Those within whose values conditions are compared."""
        return [name for name in self.fields if name not in (SUBJECT, CONDITION)]

    @property
    def fits(self) -> DataFrame:
        """A row for each fit of all runs together."""
        fits = self.quantities
        fits = fits[(fits["method"] != MEASURED) & (fits["otherwise"] == "") & fits["run"].isna()]
        return fits.drop_duplicates(["file", "model", "method"])

    def groups(self) -> Iterator[tuple[str, DataFrame]]:
        """Quantities of all runs together by the model of each recording, a table each.

        A table is of one stratum and method, and of one model if models were named.
        """
        shown, auto = self.quantities, self.settings.auto
        shown = shown[shown["chosen"] & shown["run"].isna() & (shown["otherwise"] == "")]
        keys = [*self.strata, "method", *([] if auto else ["model"])]
        for key, rows in shown.groupby(keys, sort=False):
            yield ", ".join(filter(None, key)), rows


def choices_of(
    looks: Mapping[Part, Content], settings: Settings
) -> tuple[dict[Group, Choice], Compared]:
    """The model of each group of recordings, and those in which conditions are compared."""
    groups: dict[Group, list[list[Candidate]]] = {}
    strata: dict[Group, dict[str, Group]] = {}
    for part, content in looks.items():
        groups.setdefault(part.group, []).append(
            [Candidate(**candidate) for candidate in content["candidates"]]
        )
        if SUBJECT in part.fields and part.condition:
            strata.setdefault(part.stratum, {})[part.condition] = part.group
    choices = {group: choose_model(candidates) for group, candidates in groups.items()}
    compared = dict[tuple[Group, Group], tuple[Mapping[str, str], bool]]()
    for stratum, conditions in strata.items() if settings.auto else ():
        there = [*conditions]
        for some in (*settings.condition_pairs(there), *settings.crossed(there)):
            those = {name: groups[conditions[name]] for name in some}
            models, suits = choose_jointly(those, settings.models)
            # Of many conditions a model that does not suit them all serves no test.
            compared[stratum, some] = (models if suits or len(some) == 2 else {}, suits)
    return choices, compared


def results_of(
    settings: Settings,
    looks: Mapping[Part, Content],
    choices: Mapping[Group, Choice],
    compared: Compared,
    fits: Iterable[tuple[Part, Content]],
    refused: Sequence[str],
) -> Results:
    """All frames: of looks at recordings, of fits, and of runs left out of them."""
    from pandas import DataFrame

    quantities, predicted, models = list[Content](), list[Content](), list[Content]()
    responses = dict[Part, list[Content]]()
    for part, content in [*looks.items(), *fits]:
        seen, choice = looks[part], choices[part.group].model
        head = {"file": part.name, **part.fields}
        for estimate in content["estimates"]:
            if estimate["run"] is not None and not settings.fitting.per_run:
                continue
            said = _kept(settings, [*seen["remarks"], *estimate["remarks"]])
            of_loops = _kept(settings, estimate["loop_remarks"])
            chosen = not settings.auto or estimate["model"] in ("", choice)
            place = {"recording": part.words, "runs": seen["runs"], "said": said, "chosen": chosen}
            for row in estimate["quantities"]:
                why = _why_left_out(settings, estimate, row, [*said, *of_loops])
                about = of_loops if row["kind"] == LOOP else _kept(settings, estimate["remarks"])
                words = " | ".join([*([f"not counted: {why}"] if why else []), *about])
                quantities.append(
                    {**head, **estimate, **place, **row, LEFT_OUT: why, "remarks": words}
                )
        predicted += [{**head, **row} for row in content.get("left_out", ())]
        wrong = any(remark.grade == "wrong" for remark in _kept(settings, seen["remarks"]))
        if (coefficients := content.get("responses")) and (settings.keep_all or not wrong):
            place_of = {"stratum": " ".join(part.stratum), CONDITION: part.condition}
            responses.setdefault(part, [{**place_of, **row} for row in coefficients])
        for candidate in content.get("candidates", ()):
            taken = "yes" if candidate["model"] == choice else "no"
            models.append({**head, "model": "", "chosen": taken, **candidate})
    frame = DataFrame(quantities).astype({"run": "Int64"}).drop(columns="quantities")
    # Of a pilot who changes there is no loop, and nothing to show.
    known = frame.groupby(["kind", "model", "parameter"])["value"].transform("count") > 0
    columns = ["stratum", CONDITION, "channel", "omega", "real", "imag", "std"]
    return Results(
        settings=settings,
        parts=[*looks],
        choices=choices,
        compared=compared,
        quantities=frame[known | (frame["kind"] != LOOP)].reset_index(drop=True),
        models=_models_frame(DataFrame(models)),
        left_out=DataFrame(predicted, columns=[*head, *LEFT_OUT_COLUMNS]),
        responses=DataFrame([row for rows in responses.values() for row in rows], columns=columns),
        contrasts=DataFrame(),
        factors=DataFrame(),
        refused=refused,
    )


def _kept(settings: Settings, remarks: Iterable[Sequence[str]]) -> list[Remark]:
    """Remarks from what `Content` has of them, each once, but those that the user ignores."""
    kept = (Remark(*remark) for remark in remarks if remark[0] not in settings.ignored)  # type: ignore[arg-type]
    return [*dict.fromkeys(kept)]


def _why_left_out(
    settings: Settings, estimate: Content, row: Content, remarks: Iterable[Remark]
) -> str:
    """Why a value enters no mean, test or figure; empty if it does."""
    if not estimate["usable"]:
        return str(estimate["outcome"])
    wrong = [remark.code for remark in remarks if remark.grade == "wrong"]
    why = "" if settings.keep_all else next(iter(wrong), str(row[LEFT_OUT]))
    return why or ("" if math.isfinite(row["value"]) else "no value")


def _models_frame(frame: DataFrame) -> DataFrame:
    """Rows of models.csv, from those of candidates."""
    frame = frame.drop(columns=["no_delay", "determined", "varies"])
    frame["freedom"] = frame["freedom"].where(frame["freedom"] > 0).astype("Int64")
    of_runs = ["left_out_log_likelihood", "left_out_chi_squared"]
    frame[of_runs] = frame[of_runs].map(lambda runs: sum(runs) or math.nan)
    excess = frame["chi_squared"] / frame["freedom"].astype(float)
    frame.insert(frame.columns.get_loc("freedom") + 1, "chi_squared_per_freedom", excess)
    return frame.rename(columns={"bounds": "remarks"})
