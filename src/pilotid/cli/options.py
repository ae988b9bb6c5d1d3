"""Options that several commands have, and what they mean."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer

from pilotid.cli.running import StoppedError
from pilotid.estimates.method import Method
from pilotid.methods import label_of, method_named, methods
from pilotid.naming.settings import split_list
from pilotid.pilot.catalogue import AUTO, model_named
from pilotid.pilot.model import PilotModel
from pilotid.recordings.files import Reading, read_with
from pilotid.recordings.recording import Recording
from pilotid.support import disk
from pilotid.support.disk import require_file, strict_json, write_file
from pilotid.support.numbers import ARGUMENTS, ranged
from pilotid.support.types import FloatArray, InputError

#: Metavar and help of arguments and options by name, or by command and name where a command means
#: something of its own.
MEANINGS: dict[str, tuple[str, str]] = {
    "files": ("F.csv|F.mat ...", "Recordings to read; F.mat::PART is one of several in a file."),
    "trust files": ("F.csv|F.mat", "Recording; several are runs of one."),
    "folder": ("DIR", "What `compare` wrote."),
    "first": ("A", "A study that `compare` wrote."),
    "second": ("B", "Another of the same scenarios."),
    # Recordings and how they are read.
    "mapping": (
        "u=-stick,fd=3.5*d",
        "The file's names for t, e, u, x, ft, fd, or for extra signals by names of your own; a "
        "sign or a factor before one is applied.",
    ),
    "dt": ("0.01", "Sampling interval in seconds, of files without times."),
    "joint": ("", "Take all files as runs of one recording."),
    "detrend": ("", "Take a straight line out of u, run by run, and say so."),
    "lead_in": (
        "S",
        "Seconds that are not scored before the first sample that is; a run-in counts.",
    ),
    "runs": ("2-5", "The runs to use, as in 2-5 or 1,3."),
    "span": ("0:41", "The seconds of the window to use, START:END."),
    "element": (
        "15/s^2",
        "Controlled element, for the loops' margins; else the file's, or what u and x show.",
    ),
    "check element": ("4/s^2", "Controlled element, to compare with what is seen."),
    # Models, methods and scenarios.
    "model": (
        "NAME|auto",
        "Pilot model: single, multi (needs motion of the pilot), file.py:NAME for one of your "
        "own; auto takes the catalogue's best.",
    ),
    "analyse model": (
        "NAME|auto",
        "Pilot model; repeat or use commas; auto takes the catalogue's best.",
    ),
    "check model": ("NAME,...", "Models of which is told what methods can do."),
    "trust model": ("NAME|auto", "Pilot model; auto takes the best."),
    "method": (
        "NAME",
        "Method: arx, 'arx(memory=none)', file.py:CLASS; repeat, use commas, or say all.",
    ),
    "compare method": (
        "[LABEL=]NAME",
        "Method: arx, 'arx(memory=none)', file.py:CLASS, or LABEL=NAME to label one; repeat, use "
        "commas, or say all.",
    ),
    "scenario": (
        "NAME",
        "Scenario: nominal, 'nominal(runs=3)', file.py:NAME; repeat, use commas, or say all.",
    ),
    "simulate scenario": ("SCENARIO", "See `pilotid list`."),
    "export scenario": ("SCENARIO", "See `pilotid list`; several with commas."),
    "export out": ("DIR", "Folder of the recordings."),
    "design scenario": (
        "[SCENARIO]",
        "Pilot, loop, remnant and reference forcing; default: the recordings' of --from, else "
        "nominal.",
    ),
    "like": (
        "FILE",
        "The scenario of a recording as mle fits it, or of the trust.json of `trust`.",
    ),
    "fix": ("fnm=12,dnm=.1..0.5", "Parameters held at a value, or searched between others."),
    "start": ("Kvis=0.2,tlead=1.5", "Initial guesses."),
    # Work and results.
    "seed": ("", "Seed of all random numbers."),
    "workers": ("", "Processes; default: one for each processor."),
    "out": ("DIR", "Results folder; what is done there is kept."),
    "simulate out": ("F.csv", "Recording to write, .csv, .mat or .npz."),
    "design out": ("DIR", "Folder of the design."),
    "posterior out": ("DIR", "Folder for draws, summary and figures."),
    "report out": ("DIR", "Another folder for the report, if DIR is read-only."),
    "force": ("", "Write over files that are there already."),
    "ignore": ("CODE", "Code of a warning that is left out; repeat, or use commas."),
    "plot": ("", "Open the report in a browser, or say where it is."),
    "json": ("F.json|-", "Write the results as JSON; - prints."),
    "report": ("F.html", "Write a report with figures."),
    "truth": ("F.truth.json", "Draw a simulation's truth in the report."),
    "simulate runs": ("", "Runs, each with its own remnant."),
    "brief": ("", "One line a file, and a summary of many."),
    # Studies.
    "profile": (
        "quick|full|paper",
        "quick: some recordings of the nominal scenario and of any pilot; full: 500 of every "
        "scenario and population; paper: AIAA 2008-7109 on a page of its own.",
    ),
    "replications": ("", "Recordings of each scenario."),
    "trust replications": ("", "Simulations of the recording."),
    "scheduler": ("ADDRESS", "Use the workers of this Dask scheduler instead."),
    "time_limit": ("S", "Seconds that a fit may take; 0 for no limit."),
    "retry_failed": ("", "Fit again what crashed, died, or ran out of memory or time."),
    "name": ("NAME", "Which; none lists what there is."),
    "source": ("FOLDER", "Take the files from here: no download."),
    "kind": ("", "Format of the recordings."),
    "imported": ("F.csv", "Estimates by other programs, in the folder of their `export`."),
    "people": ("NAME", "Published recordings of people instead; see fetch-data."),
    # Experiments.
    "pattern": (
        "'subj{subject}_{condition}'",
        "What the files' names say; files that differ in {run} alone are runs of one recording.",
    ),
    "contrast": (
        "A:B",
        "Conditions to compare, B less A, else all that differ in one factor; or parameters of one "
        "fit, such as tlead1:tlead2; repeat.",
    ),
    "keep_all": ("", "Count estimates that are not determined, or wrong, as well."),
    "sensitivity": ("", "Also fit another band, remnant and lead-in, and each half: a table."),
    "per_run": ("", "Also fit each run separately."),
    "left_out": ("", "Leave-one-run-out cross-validation."),
    "exclude": ("subject=6,condition=C4", "Recordings to leave out; repeat."),
    "factors": (
        "'motion=C1,C2:off;C3,C4:on;...'|F.csv|FIELDS",
        "Factors that conditions are combinations of, or fields of the pattern that are factors.",
    ),
    # Designs.
    "minimise": ("A|D|KEY,KEY", "What is made small, of relative errors."),
    "limit": ("e=1.5,u=1.5", "Largest variances of e and u, over those of the reference."),
    "estimates": ("F.json", "The pilot of a fit: fit --json."),
}
ONLY = Parameter.KEYWORD_ONLY
#: Options that are not called like their parameters, which are reserved words or other things.
SPELLED = {
    **{"mapping": "--map", "estimates": "--from", "source": "--from"},
    **{"imported": "--estimates", "kind": "--format"},
}

LARGEST_TRUTH = 2**22  # bytes of a file that names true parameters


def names_of(given: Sequence[str] | None, default: Sequence[str], all_: Sequence[str]) -> list[str]:
    """The names in options that may be repeated, hold several with commas, or say ``all``.

    Commas within parentheses belong to the settings of a name.
    """
    names = [name for text in given or () for name in split_list(text, names=True)]
    if "all" in names:
        return list(all_)
    return list(dict.fromkeys(names or default))


def methods_of(given: Sequence[str] | None, default: Sequence[str]) -> dict[str, Method]:
    """The methods that options name, by their labels."""
    named = [method_named(name) for name in names_of(given, default, list(methods()))]
    return {label_of(method): method for method in named}


def numbers_in(option: str, text: str) -> dict[str, float]:
    """Numbers by key in a text such as ``tlead=2,Kvest=3%``; a % divides by 100."""
    found = {}
    for pair in text.split(","):
        key, _, value = (part.strip() for part in pair.partition("="))
        try:
            found[key] = float(value.removesuffix("%")) / (100.0 if value.endswith("%") else 1.0)
        except ValueError:
            raise InputError(
                f"{option} {text}: '{pair}' is not PARAMETER=NUMBER; write for example tlead=1.5"
            ) from None
    return found


def with_start(model: PilotModel, text: str | None) -> PilotModel:
    """A model with the initial guesses of a text such as ``Kvis=0.2,tlead=1.5``."""
    values = {} if text is None else numbers_in("--start", text)
    try:
        return model.with_start(values)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"--start {text}: {error}") from None


def read_truth(path: Path, model: PilotModel) -> FloatArray:
    """True parameters in model order from the file that `pilotid simulate` writes."""
    require_file(path, LARGEST_TRUTH)
    try:
        held = json.loads(path.read_text(encoding="utf-8"))["parameters"]
        return model.vector({key: float(entry["value"]) for key, entry in held.items()})
    except InputError as error:
        raise InputError(f"{path}: {error}; give the truth of a recording of that model") from None
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise InputError(
            f"{path}: cannot be read as the truth of a simulation; name the F.truth.json that "
            "`pilotid simulate` wrote"
        ) from None


def require_free(inputs: Sequence[Path], *targets: str | Path | None, force: bool) -> None:
    """Refuse, before any work is done, files to write that must stay as they are."""
    named = [Path(t) for t in targets if t is not None and t != "-"]
    disk.require_free(named, read_with(inputs), force=force)


def raise_refused(refused: Sequence[str]) -> None:
    """Say what is wrong with files, once the others are done."""
    if refused:
        raise InputError("; ".join(refused))


def selected_model(recording: Recording, name: str, seed: int) -> PilotModel:
    """The model of that name, or the one best supported by the recording."""
    from pilotid.model_choice import select

    return select(recording, seed=seed).model if name == AUTO else model_named(name)


def write_json(target: str | None, value: object) -> bool:
    """Write an object to the file that --json names, or print it; whether it was printed."""
    if target == "-":
        sys.stdout.write(strict_json(value))
    elif target is not None:
        write_file(Path(target), strict_json(value).encode())
    return target == "-"


@contextmanager
def resumable(place: Path) -> Iterator[None]:
    """Work that Ctrl-C stops and the same command resumes."""
    try:
        yield
    except KeyboardInterrupt:
        raise StoppedError(
            f"stopped; {place} keeps what is done: run the same command again to resume"
        ) from None


def spelled(name: str) -> str:
    """How an option is typed."""
    return SPELLED.get(name, f"--{name.replace('_', '-')}")


def parameters_of(function: Callable[..., None]) -> list[Parameter]:
    """What users give a command: in place of a `Reading` the fields that it has."""
    found: list[Parameter] = []
    for parameter in signature(function, eval_str=True).parameters.values():
        if parameter.annotation is not Reading:
            found.append(parameter)
            continue
        hints = {**get_type_hints(Reading), "mapping": list[str] | None}
        for name, usual in vars(Reading()).items():
            default = None if name == "mapping" else usual
            found.append(Parameter(name, ONLY, default=default, annotation=hints[name]))
    return found


def as_command(function: Callable[..., None]) -> Callable[..., None]:
    """A function for typer: what is keyword-only is an option, all else an argument."""

    def described(parameter: Parameter) -> Parameter:
        name, kind = parameter.name, parameter.annotation
        metavar, text = MEANINGS.get(f"{function.__name__} {name}") or MEANINGS[name]
        known = ARGUMENTS.get(name)
        about: dict[str, Any] = {"metavar": metavar or None, "help": text}
        if known is not None and known.whole and int in (kind, *get_args(kind)):
            about["min"] = int(known.low)
        info = typer.Option(spelled(name), **about)
        if parameter.kind is not ONLY:
            info = typer.Argument(readable=name != "files", **about)
        return parameter.replace(annotation=Annotated[kind, info])

    @wraps(function)
    def run(**given: Any) -> None:
        if "reading" in signature(function).parameters:
            own = {field.name: given.pop(field.name) for field in fields(Reading)}
            given["reading"] = Reading(**{**own, "mapping": tuple(own["mapping"] or ())})
        function(**given)

    described_ones = [described(parameter) for parameter in parameters_of(function)]
    run.__signature__ = Signature(described_ones)  # type: ignore[attr-defined]
    return ranged(run, spelled)


def typed_command(command: Callable[..., None], given: Mapping[str, object]) -> str:
    """The command that does the same again: its arguments, and the options that differ."""
    first, rest = [], []
    given = {**given, **(vars(given["reading"]) if "reading" in given else {})}
    for parameter in sorted(parameters_of(command), key=lambda each: each.name == "out"):
        value = given[parameter.name]
        values = [str(v) for v in value] if isinstance(value, list | tuple) else [str(value)]
        if parameter.kind is not ONLY:
            first += [] if value is None else values
        elif value is not None and value != parameter.default:
            option = spelled(parameter.name)
            rest += [w for v in values for w in (option, *([] if value is True else [v]))]
    return shlex.join(["pilotid", command.__name__, *first, *rest])
