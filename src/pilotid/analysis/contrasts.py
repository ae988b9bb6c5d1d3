"""Contrasts: paired differences between conditions over subjects.

Values are compared as they are.  Gains and lead times are positive and skewed, and some would
compare their logarithms; a difference in the parameter's own unit is what papers report, and
differences between conditions are less skewed than what they are made of.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pilotid.analysis.combine import (
    NAN,
    effect_size,
    holm,
    plain_mean,
    signed_ranks,
)
from pilotid.analysis.rows import CONDITION, Chosen, Layout, Row, Stratum, in_order, layouts, who
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.model import PilotModel
from pilotid.support.numbers import LEVEL
from pilotid.support.types import InputError


class Pair(NamedTuple):
    """One subject's estimates in two conditions."""

    subject: str
    a: float
    b: float


@dataclass(frozen=True)
class Contrast:
    """A parameter's difference between two conditions: a line of contrasts.csv.

    What cannot be worked out is NaN, and `notes` say why.

    Attributes
    ----------
    stratum
        Values of the other fields within which the conditions are compared.
    condition_a, condition_b, model_a, model_b
        What is compared; models differ only where each condition has its own.
    method, parameter, unit
        What was estimated, and how.
    pairs
        The subjects with a usable estimate in both conditions.
    mean_a, mean_b
        Means over these subjects.
    difference, std_error, freedom, t, p, lower, upper
        Mean of b - a, its error from the scatter of the subjects, the paired t-test with its
        degrees of freedom, and the 95 % interval.
    p_holm
        p after Holm's correction for the number of pairs of conditions that were tested.
    effect_size
        Cohen's d_z (mean over standard deviation of the differences) with Hedges' correction.
    notes
        Who is left out and why, and what could not be worked out.
    left_out
        The subjects that are left out, each with the reason.
    across
        Whether the parameter stands in another channel in one model than in the other, so that the
        two numbers need not mean the same.
    robust_difference, wilcoxon_p
        The Hodges-Lehmann mean of b - a, and p of the signed-rank test.
    lower_holm, upper_holm
        The interval that goes with p_holm: it holds zero where that is above 0.05.
    misspecified
        The estimates that the lines of the forcing functions contradict, by subject and condition.
    """

    stratum: Stratum
    condition_a: str
    condition_b: str
    model_a: str
    model_b: str
    method: str
    parameter: str
    unit: str
    pairs: tuple[Pair, ...]
    mean_a: float = NAN
    mean_b: float = NAN
    difference: float = NAN
    std_error: float = NAN
    freedom: float = NAN
    t: float = NAN
    p: float = NAN
    p_holm: float = NAN
    lower: float = NAN
    upper: float = NAN
    effect_size: float = NAN
    notes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    across: bool = False
    misspecified: tuple[str, ...] = ()
    robust_difference: float = NAN
    wilcoxon_p: float = NAN
    lower_holm: float = NAN
    upper_holm: float = NAN

    @property
    def within(self) -> bool:
        """Whether it is between two parameters of the same fits, see `within_fits`."""
        return self.condition_a == self.condition_b

    @property
    def doubt(self) -> str:
        """Why it is not to be read like the others; empty if it is."""
        told = ["across models"] * self.across
        count = len(self.misspecified)
        told += [f"{count} {'fit' if count == 1 else 'fits'} contradicted"] * bool(count)
        return ", ".join(told)

    @property
    def subjects(self) -> int:
        """Number of subjects compared."""
        return len(self.pairs)


def contrasts(
    rows: Sequence[Row],
    pairs: Sequence[tuple[str, str]] = (),
    chosen: Chosen | None = None,
    models: Mapping[str, PilotModel] = MODELS,
) -> list[Contrast]:
    """Paired differences between conditions, for each stratum, method, model and parameter.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv; only fits of all runs together are compared.
    pairs
        Conditions to compare, ``("C3", "C6")`` for C6 less C3; all pairs if none are given.
    chosen
        The model of each stratum and condition, where each condition has its own: parameters
        that the two models share are compared.  None compares fits of the same model.
    models
        The models by name.

    Raises
    ------
    InputError
        If a pair names a condition that no row has, or one condition twice.
    """
    known = in_order([row.field(CONDITION) for row in rows])
    for pair in pairs:
        _require(pair, known)
    result: list[Contrast] = []
    for layout in layouts(rows, chosen):
        wanted = pairs or list(combinations(layout.conditions, 2))
        if chosen is not None:  # what only one of the two models has cannot be compared
            wanted = [pair for pair in wanted if set(pair) <= set(layout.conditions)]
        made = [_contrast(layout, a, layout, b, models) for a, b in wanted]
        result += map(_corrected, made, holm([c.p for c in made]))
    return result


def _require(pair: tuple[str, str], known: Sequence[str]) -> None:
    for condition in pair:
        if condition not in known:
            there = ", ".join(name for name in known if name) or "none"
            raise InputError(
                f"the contrast {':'.join(pair)} names the condition {condition}, which no file "
                f"has; the conditions are {there}; two parameters of one model may be compared too"
            )
    if pair[0] == pair[1]:
        raise InputError(f"the contrast {':'.join(pair)} names one condition twice; name two")


def is_across(parameter: str, models: Sequence[PilotModel]) -> bool:
    """Whether a parameter, or one of a product or sum, stands in other channels in a model.

    Channels on one signal are compared, whatever their starts are.  Loops and variances belong to
    no channel.
    """
    keys = set(re.split(r"[*+]", parameter))
    found: dict[str, set[object]] = {}
    for model in models:
        for channel in model.channels:
            factors = [(type(f), [p.key for p in f.parameters]) for f in channel.factors]
            if keys & {key for _, own in factors for key in own}:
                found.setdefault(channel.on, set()).add(repr(factors))
    return any(len(own) > 1 for own in found.values())


def _contrast(
    first: Layout, a: str, second: Layout, b: str, models: Mapping[str, PilotModel]
) -> Contrast:
    """One quantity in two conditions, or two quantities in one condition."""
    within = first is not second
    everyone = in_order([*first.cells.get(a, {}), *second.cells.get(b, {})])
    faults = {s: first.missing(s, a) or second.missing(s, b) for s in everyone}
    out = [fault for fault in faults.values() if fault]
    notes = [f"left out: {'; '.join(out)}"] if out else []
    pairs, misspecified = [], []
    for subject in (s for s in everyone if not faults[s]):
        one, two = first.cells[a][subject], second.cells[b][subject]
        pairs.append(Pair(subject, one.value, two.value))
        for condition, cell in {a: one, b: two}.items():
            where = who(subject) if within else f"{who(subject)} in {condition}"
            notes += [f"{where}: mean of {cell.recordings} recordings"] * (cell.recordings > 1)
            notes += [f"{where}: a parameter is at its bound"] * cell.at_bound
            misspecified += [where] * (not cell.agrees)
    if misspecified:
        told = ", ".join(misspecified)
        notes.append(f"the lines of the forcing functions say otherwise of {told}")
    some_model = next(iter(first.models.values()))
    one_model, other = first.models.get(a, some_model), second.models.get(b, some_model)
    both = [models[name] for name in (one_model, other) if name in models]
    across = not within and is_across(first.parameter, both)
    if across:
        notes.append("across models")
    what = f"{second.parameter} - {first.parameter}" if within else first.parameter
    units = ", ".join(dict.fromkeys((first.unit, second.unit)))
    head = first.stratum, a, b, one_model, other, first.method, what, units
    contrast = Contrast(
        *head,
        tuple(pairs),
        left_out=tuple(out),
        across=across,
        misspecified=tuple(dict.fromkeys(misspecified)),
    )
    if "," in contrast.unit and (within or len(pairs) > 1):
        return replace(contrast, notes=(*notes, f"the units differ ({contrast.unit}): no test"))
    if len(pairs) < 2:
        where = "the condition" if within else "both conditions"
        notes.append(f"{len(pairs) or 'no'} subject in {where}: a test takes two")
    return plain(replace(contrast, notes=tuple(notes)))


def plain(contrast: Contrast) -> Contrast:
    """The contrast with the means of its pairs and the paired t-test."""
    if not contrast.pairs:
        return contrast
    a, b = (np.array([getattr(pair, side) for pair in contrast.pairs]) for side in "ab")
    mean = plain_mean(b - a, float(np.abs([a, b]).max()))
    deviation = mean.std_error * math.sqrt(len(a))
    robust, ranks = signed_ranks(b - a)
    notes = contrast.notes
    if mean.std_error == 0.0:
        notes += ("all subjects have the same difference: no test",)
    tested = {name: value for name, value in vars(mean).items() if name != "value"}
    return replace(
        contrast,
        mean_a=float(a.mean()),
        mean_b=float(b.mean()),
        difference=mean.value,
        effect_size=effect_size(mean.value, deviation, len(a)),
        robust_difference=robust,
        wilcoxon_p=ranks,
        notes=notes,
        **tested,
    )


def _corrected(contrast: Contrast, p_holm: float) -> Contrast:
    """The contrast with Holm's p, and the interval of the same level."""
    from scipy.special import stdtrit

    if not (contrast.p > 0.0 and contrast.std_error > 0.0):
        return replace(contrast, p_holm=p_holm)
    level = LEVEL * contrast.p / p_holm
    reach = float(stdtrit(contrast.freedom, 1.0 - 0.5 * level)) * contrast.std_error
    low, high = contrast.difference - reach, contrast.difference + reach
    return replace(contrast, p_holm=p_holm, lower_holm=low, upper_holm=high)


def split_pairs(
    rows: Sequence[Row], pairs: Sequence[tuple[str, str]]
) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Pairs of conditions, and pairs of parameters.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv.
    pairs
        What the user compares; a name that is both is a condition.

    Raises
    ------
    InputError
        If a pair has one parameter twice.
    """
    conditions = {row.field(CONDITION) for row in rows}
    parameters = {row.parameter for row in rows} - conditions
    own = [pair for pair in pairs if set(pair) <= parameters]
    for pair in own:
        if pair[0] == pair[1]:
            raise InputError(f"the contrast {':'.join(pair)} names one parameter twice; name two")
    return [pair for pair in pairs if pair not in own], own


def within_fits(
    rows: Sequence[Row], pairs: Sequence[tuple[str, str]], chosen: Chosen | None = None
) -> list[Contrast]:
    """Second parameter less the first over subjects, for each condition, method and model.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv; only fits of all runs together count.
    pairs
        Parameters, ``("tlead1", "tlead2")`` for tlead2 less tlead1.
    chosen
        See `pilotid.analysis.contrasts.contrasts`.

    Returns
    -------
    list of Contrast
        Both conditions are that of the fits.  p is corrected after Holm for the number of
        conditions.
    """
    groups: dict[tuple[object, ...], dict[str, Layout]] = {}
    for layout in layouts(rows, chosen):
        place = layout.stratum, layout.method, tuple(layout.models.items())
        groups.setdefault(place, {})[layout.parameter] = layout
    result = []
    for own in groups.values():
        for a, b in pairs:
            if a not in own or b not in own:
                continue
            made = [_contrast(own[a], c, own[b], c, {}) for c in own[a].conditions]
            corrected = holm([c.p for c in made])
            result += [_corrected(c, p) for c, p in zip(made, corrected, strict=True)]
    return result
