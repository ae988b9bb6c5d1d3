"""What is asked of an experiment, and the tidy frames of what was found.

What is not determined does not count: an estimate at a bound, one whose interval spans more than a
factor of ten, one of a fit that failed or is graded wrong, as where the lines of the forcing
functions contradict it, and all of a recording that is graded wrong.  `LEFT_OUT` says why.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING

from pilotid.choice import Choice
from pilotid.estimate.method import Method
from pilotid.experiment.files import CONDITION, SUBJECT, Part, in_order
from pilotid.model.catalogue import MODELS, with_held
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.recording.files import Reading

if TYPE_CHECKING:
    from pandas import DataFrame

#: Kinds of quantities: of signals, which need no model; of loops, which mean the same in every
#: model; and a model's parameters.
MEASURED, LOOP, PARAMETER = KINDS = ("measured", "loop", "parameter")
#: Why a value enters no mean, test or figure; empty if it does.
LEFT_OUT = "left_out"
#: Columns of estimates.csv and loops.csv behind the fields.
QUANTITY_COLUMNS = (
    *("run", "model", "method", "parameter", "unit", "value", "std_error", "lower_95", "upper_95"),
    *("outcome", "remarks", "determined"),
)
MODEL_COLUMNS = (
    *("model", "chosen", "pilot_parameters", "parameters", "remnant", "samples", "log_likelihood"),
    *("aicc", "bic", "vaf", "left_out_log_likelihood", "chi_squared", "freedom"),
    *("chi_squared_per_freedom", "left_out_chi_squared", "remarks"),
)
LEFT_OUT_COLUMNS = (
    *("run", "model", "method", "outcome", "vaf", "log_likelihood", "seconds"),
    *("halves_percent", "halves_z"),
)
#: Recordings for which one model is chosen, or conditions that are compared.
Group = tuple[str, ...]
#: By stratum and conditions, the models in which these are compared, by condition, and whether
#: they suit all; empty where all models were named.
Compared = Mapping[tuple[Group, Group], tuple[Mapping[str, str], bool]]


@dataclass(frozen=True, eq=False)
class Settings:
    """What is done to every recording.

    Attributes
    ----------
    models, methods
        Models that the user named, by name, and methods by their labels.
    auto
        Whether the catalogue's sensible models compete with them, and the best is fitted.
    per_run, left_out
        Whether every run is fitted on its own as well, and predicted by the fit of the others.
    element
        The controlled element, where the user names it.
    seed
        Seed of all random numbers.
    pairs
        What the user contrasts; conditions that differ in one factor if nothing.
    factors
        Level of each factor (columns) by condition; None for no factors.
    keep_all
        Whether estimates that are not determined, or wrong, count as well.
    sensitivity
        Whether each recording is fitted in other ways as well.
    excluded
        Recordings that the user leaves out.
    ignored
        Codes of remarks that the user does not want to see.
    fix
        Parameters that are held or bounded, see `pilotid.model.catalogue.with_held`.
    reading
        How files are read.
    """

    models: Mapping[str, PilotModel]
    auto: bool
    methods: Mapping[str, Method]
    per_run: bool = False
    left_out: bool = False
    element: ControlledElement | None = None
    seed: int = 0
    pairs: Sequence[tuple[str, str]] = ()
    factors: DataFrame | None = None
    keep_all: bool = False
    sensitivity: bool = False
    excluded: Sequence[Part] = ()
    ignored: frozenset[str] = frozenset()
    fix: str | None = None
    reading: Reading = field(default_factory=Reading)

    @property
    def known(self) -> dict[str, PilotModel]:
        """All models that may be fitted, by name."""
        every = {**MODELS, **self.models}
        return {m.name: m for m in with_held(every.values(), self.fix)} if self.fix else every

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
        The model chosen for each group of recordings, see `group_of`.
    compared
        The models in which conditions are compared, see `Compared`.
    fits
        A row for each fit: recording, run, model, method, number of runs, VAF, outcome and what
        is told of it, `Remark`s.
    quantities
        A row for each quantity of each fit: file, the pattern's fields, `QUANTITY_COLUMNS`, the
        controlled element, kind, `LEFT_OUT`, ``otherwise`` (the other way in which it was fitted)
        and ``chosen`` (whether the model is that of the recording's own table).
    models, left_out
        Rows of models.csv and of left_out.csv.
    responses
        Coefficients at the forcing lines of the recordings that count.
    contrasts, factors
        Differences between conditions and effects of factors, see `comparisons`; empty at first.
    refused
        A sentence for each file that was left out.
    """

    settings: Settings
    parts: Sequence[Part]
    choices: Mapping[Group, Choice]
    compared: Compared
    fits: DataFrame
    quantities: DataFrame
    models: DataFrame
    left_out: DataFrame
    responses: DataFrame
    contrasts: DataFrame
    factors: DataFrame
    refused: Sequence[str] = ()

    @property
    def fields(self) -> list[str]:
        """The fields of the pattern."""
        return [name for name, _ in self.parts[0].fields]

    @property
    def strata(self) -> list[str]:
        """Those within whose values conditions are compared."""
        return [name for name in self.fields if name not in (SUBJECT, CONDITION)]

    @property
    def kinds(self) -> list[str]:
        """Columns that tell recordings of one kind from others."""
        found = [name for name in (*self.strata, CONDITION) if name in self.fields]
        return found or ["file"]

    @property
    def shown(self) -> DataFrame:
        """Quantities of all runs together by the model of each recording."""
        whole = self.quantities
        return whole[whole["chosen"] & whole["run"].isna() & (whole["otherwise"] == "")]

    def groups(self) -> Iterator[tuple[str, DataFrame]]:
        """Quantities that share a table, of one stratum and method, and of one model if named."""
        auto = self.settings.auto
        keys = [*self.strata, "method", *([] if auto else ["model"])]
        for key, rows in self.shown.groupby(keys, sort=False):
            *words, method = key if auto else key[:-1]
            words.append("performance" if method == MEASURED else f"method `{method}`")
            if key[-1] and not auto:
                words.append(f"model `{key[-1]}`")
            yield ", ".join(words), rows


def group_of(part: Part) -> Group:
    """The recordings that a recording is judged with: those of other subjects, else none."""
    alone = () if part.field(SUBJECT) else (part.name,)
    return (*part.stratum, part.field(CONDITION), *alone)
