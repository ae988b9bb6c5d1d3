"""Which pilot model: what recordings say for each of several, and the choice in words.

At the lines of multisines the control is compared with what a model in its loop makes of the
forcing functions alone.  That judges the pilot and nothing else.  The likelihood of the whole
control does not: a channel on the output can also predict the control as the inverse of the
controlled element does, x = Hc (u + fd), with a likelihood beyond that of any pilot and without a
pilot in it; on recordings of people without motion such a fit has won by 1500 in deviance while
its simulated response explained nothing of the control.

People never follow a model to within the errors of twenty lines.  Misfits are therefore set
against that of the best candidate (a quasi-likelihood: Burnham & Anderson, *Model Selection and
Multimodel Inference*, 2nd ed., sec. 2.5), and against that of runs left out of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from pilotid.checks.checks import motionless
from pilotid.checks.element_fit import GivenElement, chosen_element
from pilotid.estimate.estimate import at_bounds, bounds_reached
from pilotid.estimate.warnings import lines_objection, made_for, motionless_input
from pilotid.likelihood.estimates import simulated_vaf
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.search import LikelihoodSettings, maximise_likelihood
from pilotid.model.catalogue import MODELS, with_held
from pilotid.model.model import PilotModel
from pilotid.recording.contents import listed
from pilotid.recording.recording import Recording
from pilotid.solve.least_squares import minimise
from pilotid.spectral.coefficients import Coefficients
from pilotid.spectral.equations import LinesFit, fit_lines
from pilotid.support.numbers import DEFAULT_SEED, fit_rng
from pilotid.support.types import BoolArray, FloatArray, InputError


@dataclass(frozen=True)
class Candidate:
    """One model on one recording: a line of models.csv; NaN and 0 for what was not worked out.

    Attributes
    ----------
    model
        Name of the model.
    pilot_parameters, parameters
        Number of the pilot's parameters, and of all that were estimated.
    remnant
        Name of the remnant's model.
    samples
        Number of prediction errors that the log-likelihood is of.
    log_likelihood, aicc, bic
        Of pilot and remnant together.
    vaf
        Variance accounted for [%].
    left_out_log_likelihood
        Of each run under what the others say; empty where there is one run alone.
    chi_squared, freedom
        Chi-squared of the forcing functions' lines and its degrees of freedom; NaN and 0 where
        there are no lines.
    left_out_chi_squared
        Chi-squared of each run's lines under what the others say; empty where there is none.
    bounds
        The bounds that parameters reached, in words.
    no_delay
        Whether a delay ends at zero, which no pilot has.
    determined
        Whether the lines determine all parameters: none is at a bound or known to no better than a
        factor of ten.  Where no lines judge, whether none is at a bound.
    varies
        Whether the model varies in time.
    """

    model: str
    pilot_parameters: int
    parameters: int = 0
    remnant: str = ""
    samples: int = 0
    log_likelihood: float = math.nan
    aicc: float = math.nan
    bic: float = math.nan
    vaf: float = math.nan
    left_out_log_likelihood: tuple[float, ...] = ()
    chi_squared: float = math.nan
    freedom: int = 0
    left_out_chi_squared: tuple[float, ...] = ()
    bounds: str = ""
    no_delay: bool = False
    determined: bool = True
    varies: bool = False

    @property
    def left_out(self) -> tuple[float, ...]:
        """What each run left out of the fit is not explained by, in units of deviance."""
        if self.freedom > 0:
            return self.left_out_chi_squared
        return tuple(-2.0 * likelihood for likelihood in self.left_out_log_likelihood)


def default_candidates(recording: Recording) -> list[PilotModel]:
    """The catalogue's models that a recording can tell apart, the simplest first."""
    tried = [model for model in MODELS.values() if _is_told_apart(recording, model)]
    return sorted(tried, key=lambda model: len(model.parameters))


def _is_told_apart(recording: Recording, model: PilotModel) -> bool:
    """Whether a recording can tell a model from others, so that it is tried without being named.

    Two channels take a target and a disturbance; on target and output they take an error that
    moves.
    """
    inputs = [channel.on for channel in model.channels]
    lacks = any(
        getattr(recording, name) is None or motionless(recording, name) for name in ("ft", "fd")
    )
    return not (
        model.changes
        or inputs == ["ft"]
        or len({*inputs}) < len(inputs)
        or (len(inputs) > 1 and lacks)
        or ("e" not in inputs and motionless(recording, "e"))
        or made_for(recording, model).needs_element
    )


def compare_models(
    recording: Recording, models: Sequence[PilotModel], seed: int
) -> list[Candidate]:
    """What a recording says for each of several models, in their order.

    The lines of forcing functions judge where there are any, else likelihoods.

    Parameters
    ----------
    recording
        The recording.
    models
        The models; those that have no input in it are left out.
    seed
        Seed of the searches' random starts.

    Raises
    ------
    InputError
        If no model has all its inputs in the recording.
    """
    models = [made_for(recording, model) for model in models]
    models = [model for model in models if motionless_input(recording, model) is None]
    if not models:
        raise InputError(f"{recording.source}: none of the models has its inputs in the recording")
    if any(lines_objection(recording, model) is not None for model in models):
        return by_likelihood(recording, models, seed)
    return [
        Candidate(
            fit.model.name,
            len(fit.model.parameters),
            vaf=simulated_vaf(recording, fit.model, fit.values),
            chi_squared=fit.misfit,
            freedom=fit.freedom,
            left_out_chi_squared=_left_out_misfits(fit),
            bounds=bounds_reached(fit.model, fit.values),
            no_delay=_no_delay(fit.model, fit.values),
            determined=fit.determined,
        )
        for fit in fit_forced_response(recording, models, seed)
    ]


def by_likelihood(
    recording: Recording,
    models: Sequence[PilotModel],
    seed: int,
) -> list[Candidate]:
    """What prediction errors say for each of several models, in their order.

    Each model is fitted by maximum likelihood, the remnant along with it, in one analysis band,
    with one kind of model of the remnant and the same nuisance terms, and all are scored on the
    same samples: information criteria of fits of different bands, or of windows that end at
    different samples, say nothing.  Runs that a fit has not seen judge without any count of
    parameters: models of people are never true, and what a criterion counts as a parameter may
    only be a misfit that another parameter mends.

    Parameters
    ----------
    recording
        The recording.
    models
        Models that its signals allow, the most likely first: the kind of the remnant's model is
        what suits that one.
    seed
        Seed of the searches' random starts.
    """
    # All are weighted alike: a frequency counts if no model's input is noise there.
    signals = (channel.on for model in models for channel in model.channels)
    # A pilot who changes has no likelihood of a band: criteria of the two say nothing.
    loop = not any(model.changes for model in models)
    settings = LikelihoodSettings(wide=(), weighed=tuple(dict.fromkeys(signals)), loop=loop)
    maxima: list[Optimum] = []
    for model in models:
        optimum = maximise_likelihood(recording, model, fit_rng(seed, model.name), settings)
        settings = replace(settings, noise=optimum.joint.noise)
        maxima.append(optimum)
    terms = tuple(
        sorted({term for optimum in maxima for term in optimum.joint.prediction.nuisance_poles})
    )
    scored = min(optimum.joint.prediction.window.scored for optimum in maxima)
    return [_judged(recording, _with_terms(optimum, terms), scored) for optimum in maxima]


def _with_terms(optimum: Optimum, terms: tuple[float, ...]) -> Optimum:
    """The optimum with these nuisance terms."""
    prediction, noise = optimum.joint.prediction, optimum.joint.noise
    if prediction.nuisance_poles == terms:
        return optimum
    joint = Likelihood(replace(prediction, nuisance_poles=terms), noise)
    return replace(optimum, joint=joint).restarted_at(optimum.values)


def _judged(recording: Recording, optimum: Optimum, scored: int) -> Candidate:
    """What an optimum says for its model by so many scored samples."""
    values, whole = optimum.values, optimum.joint.prediction
    prediction = replace(whole, window=replace(whole.window, scored=scored))
    joint = Likelihood(prediction, optimum.joint.noise)
    model, pilot = prediction.model, optimum.pilot
    runs = prediction.runs
    left = [_left_out(joint, values, run) for run in range(runs)] if runs > 1 else []
    parameters, samples = len(values) + 1, joint.residuals
    log_likelihood = joint.log_likelihood(values)
    penalty = 2.0 * parameters * samples / max(samples - parameters - 1.0, 1.0)
    bounds = bounds_reached(model, pilot)
    return Candidate(
        model=model.name,
        pilot_parameters=len(pilot),
        parameters=parameters,
        remnant=joint.noise.name,
        samples=samples,
        log_likelihood=log_likelihood,
        aicc=-2.0 * log_likelihood + penalty,
        bic=-2.0 * log_likelihood + parameters * math.log(samples),
        vaf=simulated_vaf(recording, model, pilot),
        left_out_log_likelihood=tuple(left),
        bounds=bounds,
        no_delay=_no_delay(model, pilot),
        determined=not bounds,
        varies=model.changes,
    )


def _left_out(joint: Likelihood, values: FloatArray, run: int) -> float:
    """Log-likelihood of a run under what the others say."""
    prediction = joint.prediction
    every = np.eye(prediction.runs)
    others = Likelihood(prediction.mixed(np.delete(every, run, axis=0)), joint.noise)
    # The fits start close by.
    end = minimise(others.gram, values[None], others, tolerance=2e-5, iterations=12)
    variance = float(end.cost[0]) / others.scaling(end.values[0])
    variance /= others.residuals - len(values)
    alone = Likelihood(prediction.mixed(every[[run]]), joint.noise)
    return alone.log_likelihood(end.values[0], variance)


def _no_delay(model: PilotModel, values: FloatArray) -> bool:
    return bool(at_bounds(model, values, values)[0][list(model.delays)].any())


def fit_forced_response(
    recording: Recording, models: Sequence[PilotModel], seed: int
) -> list[LinesFit]:
    """What the lines say of several models, in their order, with the same weights for all.

    Parameters
    ----------
    recording
        A recording whose lines can judge all of the models, see
        `pilotid.estimate.warnings.lines_objection`.
    models
        The models, at least one.
    seed
        Seed of the searches' random starts.
    """
    by_model: dict[str, LinesFit] = {}
    for model in sorted(models, key=lambda m: len(m.parameters)):
        starts = [
            _widened(simpler, model)
            for simpler in by_model.values()
            if set(simpler.model.keys) < set(model.keys)
        ]
        rng = fit_rng(seed, model.name)
        by_model[model.name] = fit_lines(recording, model, rng, starts=starts)
    fits = [by_model[model.name] for model in models]
    # The power of the remnant as the model has it that leaves the least.
    power = min(fits, key=lambda fit: fit.misfit).power
    return [replace(fit, power=power).minimised() for fit in fits]


def _widened(simpler: LinesFit, model: PilotModel) -> FloatArray:
    """A start for a model from the optimum of one that has some of its parameters."""
    known = dict(zip(simpler.model.keys, simpler.values.tolist(), strict=True))
    starts = zip(model.keys, model.start, strict=True)
    return np.array([known.get(key, start) for key, start in starts])


def _left_out_misfits(fit: LinesFit) -> tuple[float, ...]:
    """Chi-squared of each run's lines under what the other runs say; none of one run alone."""
    runs, misfits = len(fit.coefficients.control), list[float]()
    for run in range(runs) if runs > 1 else ():
        rest = np.arange(runs) != run
        power = fit.power * runs / (runs - 1)
        others = replace(fit, coefficients=_of_runs(fit.coefficients, rest), power=power)
        alone = replace(fit, coefficients=_of_runs(fit.coefficients, ~rest), power=fit.power * runs)
        misfits.append(replace(alone, values=others.minimised().values).misfit)
    return tuple(misfits)


def _of_runs(coefficients: Coefficients, runs: BoolArray) -> Coefficients:
    """The coefficients of some runs alone."""
    weights = coefficients.weights[runs]
    size = np.sqrt(np.mean(np.abs(weights) ** 2, axis=0))
    return replace(
        coefficients,
        control=coefficients.control[runs],
        inputs=coefficients.inputs[:, runs],
        weights=weights / np.where(size == 0.0, 1.0, size),  # zero at lines they do not have
    )


#: Points of VAF by which a model may explain less of the control than the best one, where only
#: the likelihood judges: beyond, it describes the loop and not the pilot.
LOST = 10.0

#: A model with more parameters is taken where runs left out favour it with no larger chance of
#: doing so by accident: several candidates compete, and the luckiest of them is looked at.
SELDOM = 0.01

#: So many runs at least can show that.  Where there are fewer, an information criterion judges.
#: Either way a model with more parameters must be better by so much in deviance.
RUNS, CLOSE = 8, 4.0

#: Share of recordings in which a delay may end at zero with a model that serves for contrasts.
DELAYLESS = 0.1


class Choice(NamedTuple):
    """Name of the model chosen for recordings of one condition, and why, in sentences."""

    model: str
    reason: str


def choose_model(recordings: Sequence[Sequence[Candidate]]) -> Choice:
    """The simplest model that explains recordings as well as any.

    Runs left out of the fit judge: of the models whose misfit there is not clearly above the
    smallest, the one with the fewest parameters (the idea of the one-standard-error rule; Hastie,
    Tibshirani & Friedman, *The Elements of Statistical Learning*, 2nd ed., sec. 7.10).  What is
    clear a signed-rank test says: one run may differ a hundred times as much as another.  Few
    runs are judged by an information criterion.

    Parameters
    ----------
    recordings
        For each recording the candidates, see `compare_models`.
    """
    judged = _Judged(recordings)
    return Choice(judged.taken, judged.reason())


class _Judged:
    """Candidates on the recordings of one condition: what each leaves above the best."""

    def __init__(self, recordings: Sequence[Sequence[Candidate]]) -> None:
        every = [candidate for file in recordings for candidate in file]
        shared = set.intersection(*({c.model for c in file} for file in recordings))
        self.names = [c.model for c in recordings[0] if c.model in shared]
        self.files = [{c.model: c for c in file} for file in recordings]
        self.parameters = {n: self.files[0][n].pilot_parameters for n in self.names}
        self.by_lines = all(c.freedom > 0 for c in every)
        credible = self.names if self.by_lines else self._credible()
        runs = sum(len(file[self.names[0]].left_out) for file in self.files)
        self.many = runs >= RUNS and all(c.left_out for c in every if c.model in shared)
        # A constant pilot does not say when it changes: the time of change takes what is largest
        # by chance over all times, and a criterion that counts it as a parameter falls for it.
        varies = any(c.varies for c in every)
        self.criterion = "chi_squared" if self.by_lines else "bic" if varies else "aicc"
        deficits = self._deficits(credible)
        best = min(credible, key=lambda name: (sum(deficits[name]), self.parameters[name]))
        self.least = {name: np.subtract(d, deficits[best]) for name, d in deficits.items()}
        self.left = {name: float(above.sum()) for name, above in self.least.items()}
        self.close = [name for name in credible if name == best or not self._is_worse(name)]
        self.taken = min(self.close, key=lambda n: (self.parameters[n], self.left[n]))

    def is_pilot(self, name: str) -> bool:
        """Whether a model leaves pilots their delays."""
        return sum(file[name].no_delay for file in self.files) <= DELAYLESS * len(self.files)

    def determines(self, name: str) -> bool:
        """Whether at least half of the recordings determine all parameters of a model."""
        return 2 * sum(file[name].determined for file in self.files) >= len(self.files)

    def _credible(self) -> list[str]:
        """Models that explain about as much of the control as the best one."""
        vaf = np.array([[file[name].vaf for name in self.names] for file in self.files])
        near = (vaf >= vaf.max(axis=1, keepdims=True) - LOST).all(axis=0)
        return [*compress(self.names, near)] or [self.names[int(vaf.sum(axis=0).argmax())]]

    def _deficits(self, names: Sequence[str]) -> dict[str, list[float]]:
        """What models leave unexplained, in units of deviance: by run left out, else by file."""
        deficits: dict[str, list[float]] = {name: [] for name in names}
        for file in self.files:
            # What even the best candidate cannot follow counts as noise.
            lines, size = self.by_lines, 1.0
            if lines:
                size = max(1.0, min(file[n].chi_squared / file[n].freedom for n in names))
            for name, unexplained in deficits.items():
                candidate = file[name]
                if self.many:
                    unexplained += [m / size for m in candidate.left_out]
                elif lines:
                    penalty = 2.0 * candidate.pilot_parameters
                    unexplained.append(candidate.chi_squared / size + penalty)
                else:
                    unexplained.append(getattr(candidate, self.criterion))
        return deficits

    def _is_worse(self, name: str) -> bool:
        """Whether a model leaves clearly more unexplained than the best one."""
        if self.left[name] <= CLOSE or not self.many:
            return self.left[name] > CLOSE
        from scipy.stats import wilcoxon

        return float(wilcoxon(self.least[name], alternative="greater").pvalue) < SELDOM

    def reason(self) -> str:
        """Why the model is taken, in sentences; empty where it is the only one."""
        if not any(len(candidates) > 1 for candidates in self.files):
            return ""
        where = "at the lines of the forcing functions" if self.by_lines else "by prediction errors"
        judges = {"chi_squared": "a quasi-likelihood criterion", "aicc": "AICc", "bic": "BIC"}
        judge, what = judges[self.criterion], "deviance with its penalty for parameters"
        if self.many:  # of runs left out the deviance is comparable without a penalty
            judge = f"{len(self.least[self.taken])} runs, each left out of its fit"
            what = "deviance"
        names = sorted(self.left, key=self.left.__getitem__)
        sentence = f"{self.taken} was chosen among {listed(names)} {where} ({judge})."
        above = [(n, self.left[n] - self.left[self.taken]) for n in names if n != self.taken]
        if above:
            sizes = ", ".join(f"{n} {s:.0f}" if s < 1e6 else f"{n} over 1e6" for n, s in above)
            sentence += f" The others' {what}, less that of {self.taken}: {sizes}."
        if lost := [name for name in self.names if name not in names]:
            sentence += f" Not credible, with a VAF more than {LOST:g} points below the best: "
            sentence += f"{listed(lost)}."
        return sentence


def choose_jointly(
    conditions: Mapping[str, Sequence[Sequence[Candidate]]], models: Mapping[str, PilotModel]
) -> tuple[dict[str, str], bool]:
    """The models in which conditions are compared, by condition, and whether they suit them all.

    Conditions whose own choices have channels on other signals keep those; the channel on the
    error is the same in all models, so that its parameters mean the same.  A model is taken only
    if it is determined in at least half of the recordings of each of its conditions.  Of several
    the simplest are taken that suit every condition: not clearly worse than the best there, and a
    delay of zero in no more than a tenth of the recordings.  Where none suit all, the misfit
    decides.  Empty if no models are determined.

    Parameters
    ----------
    conditions
        The recordings' candidates by condition, see `compare_models`.
    models
        The candidates' models by name.
    """
    judged = {condition: _Judged(files) for condition, files in conditions.items()}
    groups: dict[frozenset[str], list[_Judged]] = {}
    for one in judged.values():
        groups.setdefault(_inputs(models[one.taken]), []).append(one)

    def rank(name: str, members: Sequence[_Judged]) -> tuple[bool, bool, float, float]:
        """Whether a model does not suit, and is no pilot; parameters, or misfit; misfit."""
        left = sum(one.left.get(name, math.inf) for one in members)
        delayless = not all(one.is_pilot(name) for one in members)
        suits = not delayless and all(name in one.close for one in members)
        return not suits, delayless, members[0].parameters[name] if suits else left, left

    options = []
    for family in dict.fromkeys(map(_on_error, models.values())):
        best = {}
        for inputs, members in groups.items():
            able = [
                name
                for name in members[0].names
                if all(name in one.names and one.determines(name) for one in members)
                and (_inputs(models[name]), _on_error(models[name])) == (inputs, family)
            ]
            if able:
                best[inputs] = min((rank(name, members), name) for name in able)
        if len(best) == len(groups):
            ranks = tuple(map(sum, zip(*(ranked for ranked, _ in best.values()), strict=True)))
            options.append((ranks, {inputs: name for inputs, (_, name) in best.items()}))
    if not options:
        return {}, False
    (unsuited, *_), names = min(options, key=lambda option: option[0])
    chosen = {c: names[_inputs(models[one.taken])] for c, one in judged.items()}
    return chosen, not unsuited


def _inputs(model: PilotModel) -> frozenset[str]:
    return frozenset(channel.on for channel in model.channels)


def _on_error(model: PilotModel) -> tuple[object, ...]:
    """What acts on the error, whatever its starts are."""
    factors = (f for channel in model.channels if channel.on == "e" for f in channel.factors)
    return tuple((type(f), *(p.key for p in f.parameters)) for f in factors)


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
    recording: Recording,
    models: Sequence[PilotModel] = (),
    seed: int = DEFAULT_SEED,
    fixed: str | None = None,
    element: GivenElement = None,
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
    fixed
        Parameters of the catalogue's models that are held or bounded, see
        `pilotid.model.catalogue.with_held`.
    element
        The controlled element; None for the one that the recording names or shows.
    """
    if element:
        recording = chosen_element(recording, element).named_in(recording)
    among = {m.name: m for m in models or with_held(default_candidates(recording), fixed)}
    if all(motionless_input(recording, model) for model in among.values()):
        first = next(iter(among.values()))
        return Selection(first, "No model has all its inputs in the recording.", ())
    candidates = compare_models(recording, list(among.values()), seed)
    choice = choose_model([candidates])
    reason = choice.reason
    if not models:
        tried = {candidate.model for candidate in candidates}
        reason += f" Not tried: {listed([name for name in MODELS if name not in tried])}."
    return Selection(among[choice.model], reason.strip(), tuple(candidates))
