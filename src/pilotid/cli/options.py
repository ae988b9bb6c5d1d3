"""Options that commands have, what they mean, and what several commands do with them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any

import typer

from pilotid.estimate.method import Method
from pilotid.methods import METHODS, label_of, method_named
from pilotid.model.catalogue import AUTO, model_named, with_held
from pilotid.model.model import PilotModel
from pilotid.recording.files import read_with
from pilotid.support import disk
from pilotid.support.disk import strict_json, write_file
from pilotid.support.naming import split_list
from pilotid.support.types import InputError

#: Metavar and help of arguments and options by name, or by command and name where a command means
#: something of its own.
MEANINGS: dict[str, tuple[str, str]] = {
    "files": ("F.csv|F.mat ...", "Recordings to read; F.mat::PART is one of several in a file."),
    "folder": ("DIR", "What `compare` wrote."),
    "first": ("A", "A study that `compare` wrote."),
    "second": ("B", "Another of the same scenarios."),
    # Recordings and how they are read.
    "mapping": ("u=-stick,fd=3.5*d", "The file's names for t, e, u, x, ft, fd and extra signals."),
    "dt": ("0.01", "Sampling interval in seconds, of files without times."),
    "joint": ("", "Take all files as runs of one recording."),
    "detrend": ("", "Take a straight line out of u, run by run, and say so."),
    "lead_in": ("S", "Seconds before the first scored sample; a run-in counts."),
    "runs": ("2-5", "The runs to use, as in 2-5 or 1,3."),
    "span": ("0:41", "The seconds of the window to use, START:END."),
    "element": ("15/s^2", "Controlled element; else the file's, or what u and x show."),
    # Models, methods and scenarios.
    "model": ("NAME|auto", "Pilot model: single, multi, file.py:NAME; auto takes the best."),
    "method": ("NAME", "Method: 'arx(memory=none)', file.py:CLASS; repeat, use commas, or all."),
    "compare method": ("[LABEL=]NAME", "Method, as for fit; LABEL=NAME gives it a label."),
    "scenario": ("SCENARIO", "See `pilotid list`; 'nominal(runs=3)', file.py:NAME."),
    "compare scenario": ("NAME", "The same; repeat, use commas, or say all."),
    "like": ("FILE", "The scenario of a recording as mle fits it, or of a trust.json."),
    "fix": ("fnm=12,dnm=.1..0.5", "Parameters held at a value, or searched between others."),
    # Work and results.
    "seed": ("", "Seed of all random numbers."),
    "workers": ("", "Processes; default: one for each processor."),
    "out": ("DIR", "Results folder; what is done there is kept."),
    "simulate out": ("F.csv", "Recording to write, .csv, .mat or .npz."),
    "json": ("F.json|-", "Write the results as JSON; - prints."),
    "report": ("F.html", "Write a report with figures."),
    "simulate runs": ("", "Runs, each with its own remnant."),
    "brief": ("", "One line a file, and a summary of many."),
    # Studies.
    "profile": ("quick|full|paper", "full: every scenario, 500 times; paper: AIAA 2008-7109."),
    "replications": ("", "Recordings of each scenario; of trust: simulations."),
    "scheduler": ("ADDRESS", "Use the workers of this Dask scheduler instead."),
    "time_limit": ("S", "Seconds that a fit may take; 0 for no limit."),
    "retry_failed": ("", "Fit again what crashed, died, or ran out of memory or time."),
    "name": ("NAME", "Which; none lists what there is."),
    "kind": ("", "Format of the recordings."),
    "imported": ("F.csv", "Estimates by other programs, in the folder of their `export`."),
    "people": ("NAME", "Published recordings of people instead; see fetch-data."),
    # Experiments.
    "pattern": ("'subj{subject}_{condition}'", "What the files' names say; {run} tells runs."),
    "contrasts": ("A:B", "Conditions to compare, B less A; repeat."),
    "keep_all": ("", "Count estimates that are not determined, or wrong, as well."),
    "sensitivity": ("", "Also fit another band, remnant and lead-in, and each half: a table."),
    "per_run": ("", "Also fit each run separately."),
    "left_out": ("", "Leave-one-run-out cross-validation."),
    "exclude": ("subject=6,condition=C4", "Recordings to leave out; repeat."),
    "factors": ("'motion=C1,C2:off;...'|FIELDS", "What conditions combine; or pattern fields."),
    # Designs.
    "minimise": ("A|D|KEY,KEY", "What is made small, of relative errors."),
    "limit": ("e=1.5,u=1.5", "Largest variances of e and u, over those of the reference."),
    "estimates": ("F.json", "The pilot of a fit: fit --json."),
}
#: Least and largest values of options; more takes days, or more memory than there is, and tells no
#: more.
RANGES: dict[str, tuple[float, float]] = {
    "seed": (0, 2**64 - 1),
    "replications": (1, 10**6),
    "workers": (1, 256),
    "runs": (1, 1000),
    "lead_in": (0.0, 3600.0),
    "dt": (1e-5, 1.0),
    "time_limit": (0.0, 1e7),
}
ONLY = Parameter.KEYWORD_ONLY
#: Options that are not called like their parameters, which are reserved words or other things.
SPELLED = {
    "mapping": "--map",
    "contrasts": "--contrast",
    "estimates": "--from",
    "imported": "--estimates",
    "kind": "--format",
}


def as_command(function: Callable[..., None]) -> Callable[..., None]:
    """A function for typer: what is keyword-only is an option, all else an argument.

    The fields of a dataclass are options of their own.
    """
    own = signature(function, eval_str=True).parameters
    kinds: dict[str, Any] = {n: p.annotation for n, p in own.items() if is_dataclass(p.annotation)}
    groups = {name: signature(kind, eval_str=True).parameters for name, kind in kinds.items()}
    single = {name: p for name, p in own.items() if name not in groups}

    def described(p: Parameter) -> Parameter:
        metavar, text = MEANINGS.get(f"{function.__name__} {p.name}") or MEANINGS[p.name]
        about: dict[str, Any] = {"metavar": metavar or None, "help": text}
        if p.name in RANGES and p.annotation is not str:  # --runs 2-5
            about["min"], about["max"] = RANGES[p.name]
        typed = SPELLED.get(p.name, f"--{p.name.replace('_', '-')}")
        is_argument = p.name in single and p.kind is not ONLY
        info = typer.Argument(**about) if is_argument else typer.Option(typed, **about)
        kind = list[str] if p.annotation == Sequence[str] else p.annotation
        return p.replace(kind=ONLY, annotation=Annotated[kind, info])

    @wraps(function)
    def run(**given: Any) -> None:
        for name, fields in groups.items():
            given[name] = kinds[name](**{field: given.pop(field) for field in fields})
        function(**given)

    every = [p for fields in (single, *groups.values()) for p in fields.values()]
    run.__signature__ = Signature([*map(described, every)])  # type: ignore[attr-defined]
    return run


#: The command line, for reports that name it.
TYPED: list[str] = []


def names_of(given: Sequence[str] | None, default: Sequence[str], all_: Sequence[str]) -> list[str]:
    """The names in options that may be repeated, hold several with commas, or say ``all``."""
    names = [name for text in given or () for name in split_list(text)] or default
    return list(dict.fromkeys(n for name in names for n in (all_ if name == "all" else [name])))


def methods_of(given: Sequence[str] | None, default: Sequence[str]) -> dict[str, Method]:
    """The methods that options name, by their labels."""
    named = [method_named(name) for name in names_of(given, default, list(METHODS))]
    return {label_of(method): method for method in named}


def numbers_in(option: str, text: str) -> dict[str, float]:
    """Numbers by key in a text such as ``e=1.5,u=2``."""
    try:
        pairs = [pair.split("=") for pair in text.split(",")]
        return {key.strip(): float(value) for key, value in pairs}
    except ValueError:
        raise InputError(f"{option} {text}: is not SIGNAL=NUMBER,..., as in e=1.5,u=2") from None


def model_of(text: str, fix: str | None) -> PilotModel | None:
    """The model that an option names, with parameters held and initial guesses; None for auto."""
    return None if text == AUTO else with_held([model_named(text)], fix)[0]


def require_free(inputs: Sequence[Path], json: str | None, report: Path | None = None) -> None:
    """Refuse, before any work is done, files to write that must stay as they are."""
    named = [Path(t) for t in (json, report) if t is not None and t != "-"]
    disk.require_free(named, read_with(inputs))
    if report:
        disk.require_suffix(report, str(report), (".html",), "a report is an .html file")


def raise_refused(refused: Sequence[str]) -> None:
    """Say what is wrong with files, once the others are done."""
    if refused:
        raise InputError("; ".join(refused))


def write_json(target: str | None, entries: Iterable[object]) -> bool:
    """Write the one object, or all, to the file that --json names; whether they were printed."""
    if target is None:
        return False
    every = [*entries]
    text = strict_json(every[0] if len(every) == 1 else every)
    if target == "-":
        sys.stdout.write(text)
    else:
        write_file(Path(target), text.encode())
    return target == "-"
