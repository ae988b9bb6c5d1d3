"""What is asked of an experiment, and the tidy frames of what came out.

What is not determined does not count: an estimate at a bound, one whose interval spans more than a
factor of ten, one of a fit that failed or is graded wrong, as where the lines of the forcing
functions contradict it, and all of a recording that is graded wrong.  The column
``left_out`` says why, and is empty where a value counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

from pandas import DataFrame

from pilotid.estimate.method import Method
from pilotid.experiment.files import Part, in_order
from pilotid.likelihood.choice import Candidate, Choice, choose_jointly, choose_model
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.recording.files import Reading
from pilotid.support.remarks import Remark

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
        Names of those that the user named; if none, the catalogue's sensible models compete, and
        the best is fitted.
    pairs
        What the user contrasts; conditions that differ in one factor if nothing.
    factors
        Level of each factor (columns) by condition; empty for no factors.
    keep_all
        Whether estimates that are not determined, or wrong, count as well.
    excluded
        Recordings that the user leaves out.
    """

    fitting: Fitting
    models: Mapping[str, PilotModel]
    named: Sequence[str]
    pairs: Sequence[tuple[str, str]] = ()
    factors: DataFrame = field(default_factory=DataFrame)
    keep_all: bool = False
    excluded: Sequence[Part] = ()

    @property
    def auto(self) -> bool:
        """Whether models are chosen."""
        return not self.named

    def condition_pairs(self, conditions: Sequence[str]) -> list[tuple[str, str]]:
        """The pairs of conditions that are contrasted."""
        if self.pairs:
            return [pair for pair in self.pairs if set(pair) <= set(conditions)]
        if self.factors.empty:
            return [*combinations(in_order(conditions), 2)]
        known, levels = in_order({*conditions} & {*self.factors.index}), self.factors.T
        return [(a, b) for a, b in combinations(known, 2) if (levels[a] != levels[b]).sum() == 1]

    def crossed(self, conditions: Sequence[str]) -> list[Group]:
        """All conditions that the factors cross, if they are among these."""
        every = tuple(self.factors.index)
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
        controlled element, kind (see `pilotid.experiment.comparisons.KINDS`), ``left_out``,
        ``otherwise`` (the other way in which it was fitted), ``chosen`` (whether the model is that
        of the recording's own table), the recording in words,
        its number of runs, the fit's VAF and all `Remark`s on recording and fit (``said``).
    models, left_out
        Rows of models.csv and of left_out.csv.
    responses
        Coefficients at the forcing lines of the recordings that count.
    refused
        A sentence for each file or fit that there is not.
    contrasts, factors
        Differences between conditions and effects of factors, see `comparisons`; empty at first.
    """

    settings: Settings
    parts: Sequence[Part]
    choices: Mapping[Group, Choice]
    compared: Compared
    quantities: DataFrame
    models: DataFrame
    left_out: DataFrame
    responses: DataFrame
    refused: Sequence[str]
    contrasts: DataFrame = field(default_factory=DataFrame)
    factors: DataFrame = field(default_factory=DataFrame)

    @property
    def fields(self) -> list[str]:
        """The fields of the pattern."""
        return [*self.parts[0].fields]

    @property
    def strata(self) -> list[str]:
        """Those within whose values conditions are compared."""
        return [name for name in self.fields if name not in ("subject", "condition")]

    @property
    def fits(self) -> DataFrame:
        """A row for each fit of all runs together."""
        fits = self.quantities
        fits = fits[(fits["method"] != "measured") & (fits["otherwise"] == "") & fits["run"].isna()]
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


def conditions_of(parts: Iterable[Part]) -> dict[Group, list[str]]:
    """The conditions of each stratum."""
    strata = dict[Group, dict[str, None]]()
    for part in parts:
        strata.setdefault(part.stratum, {})[part.condition] = None
    return {stratum: [*conditions] for stratum, conditions in strata.items()}


def choices_of(
    looks: Mapping[Part, Content], settings: Settings
) -> tuple[dict[Group, Choice], Compared]:
    """The model of each group of recordings, and those in which conditions are compared."""
    groups: dict[Group, list[list[Candidate]]] = {}
    for part, content in looks.items():
        candidates = [Candidate(**candidate) for candidate in content["candidates"]]
        groups.setdefault(part.group, []).append(candidates)
    choices = {group: choose_model(candidates) for group, candidates in groups.items()}
    compared = dict[tuple[Group, Group], tuple[Mapping[str, str], bool]]()
    for stratum, there in conditions_of(looks).items() if settings.auto else ():
        for some in (*settings.condition_pairs(there), *settings.crossed(there)):
            those = {condition: groups[*stratum, condition] for condition in some}
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
    quantities, predicted, models = list[Content](), list[Content](), list[Content]()
    responses = dict[Part, list[Content]]()
    for part, content in [*looks.items(), *fits]:
        seen, choice = looks[part], choices[part.group].model
        head = {"file": part.name, **part.fields}
        of_part = {**head, "recording": part.words, "runs": seen["runs"]}
        for row in content["rows"]:
            if row["run"] is None or settings.fitting.per_run:
                chosen = not settings.auto or row["model"] in ("", choice)
                judged = _judged(settings, seen["remarks"], row)
                quantities.append({**of_part, **row, **judged, "chosen": chosen})
        predicted += [{**head, **row} for row in content.get("left_out", ())]
        wrong = any(remark.grade == "wrong" for remark in _remarks(seen["remarks"]))
        if (coefficients := content.get("responses")) and (settings.keep_all or not wrong):
            place = {"stratum": " ".join(part.stratum), "condition": part.condition}
            responses.setdefault(part, [{**place, **row} for row in coefficients])
        for candidate in content.get("candidates", ()):
            taken = "yes" if candidate["model"] == choice else "no"
            models.append({**head, "model": "", "chosen": taken, **candidate})
    columns = ["stratum", "condition", "channel", "omega", "real", "imag", "std"]
    return Results(
        settings=settings,
        parts=[*looks],
        choices=choices,
        compared=compared,
        quantities=DataFrame(quantities).astype({"run": "Int64"}),
        models=_models_frame(DataFrame(models)),
        left_out=DataFrame(predicted),
        responses=DataFrame([row for rows in responses.values() for row in rows], columns=columns),
        refused=refused,
    )


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
    words = [f"not counted: {why}"] if why else []
    return {"left_out": why, "said": said, "remarks": " | ".join([*words, *about])}


def _remarks(found: Iterable[Sequence[str]]) -> list[Remark]:
    """Remarks from what `Content` has of them, each once."""
    return [*dict.fromkeys(Remark(*remark) for remark in found)]  # type: ignore[arg-type]


def _models_frame(frame: DataFrame) -> DataFrame:
    """Rows of models.csv, from those of candidates."""
    frame = frame.drop(columns=["no_delay", "determined", "varies"])
    frame["freedom"] = frame["freedom"].where(frame["freedom"] > 0).astype("Int64")
    of_runs = ["left_out_log_likelihood", "left_out_chi_squared"]
    frame[of_runs] = frame[of_runs].map(lambda runs: sum(runs) or math.nan)
    return frame.rename(columns={"bounds": "remarks"})
