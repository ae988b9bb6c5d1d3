"""Which model: candidates ranked by what recordings say, and the reason in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.analysis.candidates import Candidate, compared, sensible
from pilotid.estimates.applicability import motionless_input
from pilotid.pilot.model import PilotModel
from pilotid.recordings.contents import listed
from pilotid.recordings.recording import Recording
from pilotid.seeds import DEFAULT_SEED

#: Points of VAF by which a model may explain less of the control than the best one, where only
#: the likelihood judges: beyond, it describes the loop and not the pilot.
LOST = 10.0

#: A model with more parameters is taken where runs left out favour it with no larger chance of
#: doing so by accident: several candidates compete, and the luckiest of them is looked at.
SELDOM = 0.01

#: So many runs at least can show that.  Where there are fewer, an information criterion judges.
#: Either way a model with more parameters must be better by so much in deviance.
RUNS, CLOSE = 8, 4.0


@dataclass(frozen=True)
class Choice:
    """The model chosen for one recording, or for several of one condition.

    Attributes
    ----------
    model
        Its name.
    reason
        Why, in sentences.
    """

    model: str
    reason: str


def chosen(recordings: Sequence[Sequence[Candidate]]) -> Choice:
    """The simplest model that explains recordings as well as any.

    Runs left out of the fit judge: of the models whose misfit there is not clearly above the
    smallest, the one with the fewest parameters (the idea of the one-standard-error rule; Hastie,
    Tibshirani & Friedman, *The Elements of Statistical Learning*, 2nd ed., sec. 7.10).  What is
    clear a signed-rank test says: one run may differ a hundred times as much as another.  Few
    runs are judged by an information criterion.

    Parameters
    ----------
    recordings
        For each recording the candidates, see `compared`.
    """
    names = [c.model for c in recordings[0]]
    names = [name for name in names if all(name in [c.model for c in held] for held in recordings)]
    held = [{c.model: c for c in candidates} for candidates in recordings]
    by_lines = all(c.freedom > 0 for own in held for c in own.values())
    credible = names if by_lines else _credible(held, names)
    runs = sum(len(own[names[0]].left_out) for own in held)
    many = runs >= RUNS and all(own[name].left_out for own in held for name in names)
    deficits = _deficits(held, credible, by_lines=by_lines, left_out=many)
    best = min(credible, key=lambda name: (sum(deficits[name]), held[0][name].pilot))
    least = {n: [a - b for a, b in zip(deficits[n], deficits[best], strict=True)] for n in credible}
    close = [n for n in credible if n == best or not _clear(least[n], many=many)]
    taken = min(close, key=lambda name: (held[0][name].pilot, sum(least[name])))
    told = _reason(held, taken, least, by_lines=by_lines, left_out=many)
    told += _warnings(held, names, credible, taken)
    return Choice(taken, " ".join(told))


def _credible(held: Sequence[Mapping[str, Candidate]], names: Sequence[str]) -> list[str]:
    """Models that explain about as much of the control as the best one."""
    most = [max(own[name].vaf for name in names) for own in held]
    return [
        name
        for name in names
        if all(own[name].vaf >= top - LOST for own, top in zip(held, most, strict=True))
    ] or [max(names, key=lambda name: sum(own[name].vaf for own in held))]


def _deficits(
    held: Sequence[Mapping[str, Candidate]], names: Sequence[str], *, by_lines: bool, left_out: bool
) -> dict[str, list[float]]:
    """What each model leaves unexplained, in units of deviance: by run left out, else by file."""
    found: dict[str, list[float]] = {name: [] for name in names}
    for own in held:
        # What even the best candidate cannot follow counts as noise.
        size = max(1.0, min(own[n].excess for n in names)) if by_lines else 1.0
        for name in names:
            candidate = own[name]
            if left_out:
                found[name] += [m / size for m in candidate.left_out]
            elif by_lines:
                found[name].append(candidate.misfit / size + 2.0 * candidate.pilot)
            else:
                found[name].append(candidate.aicc)
    return found


def _clear(deficits: Sequence[float], *, many: bool) -> bool:
    """Whether a model leaves clearly more unexplained than the best one, by run or by file."""
    if sum(deficits) <= CLOSE:
        return False
    if not many:
        return True
    from scipy.stats import wilcoxon

    return float(wilcoxon(deficits, alternative="greater").pvalue) < SELDOM


def _standard_error(differences: Sequence[float]) -> float:
    """Of their sum."""
    return float(np.std(differences, ddof=1) * math.sqrt(len(differences)))


def _reason(
    held: Sequence[Mapping[str, Candidate]],
    taken: str,
    least: Mapping[str, Sequence[float]],
    *,
    by_lines: bool,
    left_out: bool,
) -> list[str]:
    if all(len(candidates) == 1 for candidates in held):
        return []
    what = "at the lines of the forcing functions" if by_lines else "by the errors of prediction"
    criterion = "a quasi-likelihood criterion" if by_lines else "AICc"
    judge = f"{len(least[taken])} runs, each left out of its fit" if left_out else criterion
    names = sorted(least, key=lambda name: sum(least[name]))
    told = [f"{taken} was chosen among {listed(names)} {what} ({judge})."]
    own, pilot = held[0], held[0][taken].pilot
    for name in names:
        differences = [a - b for a, b in zip(least[name], least[taken], strict=True)]
        size = f"{abs(sum(differences)):.0f}"
        size += f" +- {_standard_error(differences):.0f}" if left_out else ""
        if name != taken and sum(differences) < 0.0:
            told.append(
                f"{name} leaves {size} less of the deviance unexplained, which is no clear gain "
                f"for {own[name].pilot} parameters instead of {pilot}."
            )
        elif name != taken:
            told.append(f"{name} leaves {size} more.")
    return told


def _warnings(
    held: Sequence[Mapping[str, Candidate]],
    names: Sequence[str],
    credible: Sequence[str],
    taken: str,
) -> list[str]:
    told = []
    for name in names:
        if name not in credible:
            vaf = min(own[name].vaf for own in held)
            told.append(
                f"{name} explains no more than {vaf:.0f} % of the control of a recording that "
                "others explain better: it describes the loop, not the pilot."
            )
    known = all(math.isfinite(own[name].bic) for own in held for name in names)
    likeliest = min(names, key=lambda name: sum(own[name].bic for own in held)) if known else taken
    if likeliest != taken:
        lower = sum(own[taken].bic - own[likeliest].bic for own in held)
        told.append(f"BIC of the whole control prefers {likeliest}, by {lower:.0f}")
        lost = max(own[taken].vaf - own[likeliest].vaf for own in held)
        told[-1] += f", though its VAF is up to {lost:.0f} points lower." if lost > LOST else "."
    disguised = [
        name
        for name in names
        if name != taken and 2 * sum(own[name].overdamped for own in held) > len(held)
    ]
    if disguised:
        told.append(
            f"{listed(disguised)} {'makes' if len(disguised) == 1 else 'make'} do with an "
            "overdamped neuromuscular system in place of a lag."
        )
    bounds = [own[taken].bounds for own in held if own[taken].bounds]
    if bounds:
        told.append(f"With {taken}, {len(bounds)} of {len(held)} end at a bound ({bounds[0]}).")
    return told


@dataclass(frozen=True)
class Selection:
    """A model for one recording, and what was known when it was taken.

    Attributes
    ----------
    model
        The model.
    reason
        Why, in sentences.
    candidates
        All that were compared.
    """

    model: PilotModel
    reason: str
    candidates: tuple[Candidate, ...]


def select(
    recording: Recording, models: Sequence[PilotModel] = (), seed: int = DEFAULT_SEED
) -> Selection:
    """Choose a model for one recording.

    Parameters
    ----------
    recording
        The recording.
    models
        The candidates; none for those of the catalogue that the recording can tell apart.
    seed
        Seed of the searches' random starts.
    """
    among = {model.name: model for model in models or sensible(recording)}
    if all(motionless_input(recording, model) for model in among.values()):
        first = next(iter(among.values()))
        return Selection(first, "No model has all its inputs in the recording.", ())
    candidates = compared(recording, list(among.values()), seed, likelihood=False)
    choice = chosen([candidates])
    return Selection(among[choice.model], choice.reason, tuple(candidates))
