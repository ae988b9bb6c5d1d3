"""Options that several commands have, and what they mean."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from inspect import signature
from pathlib import Path
from typing import Annotated

import typer
from typer.models import ArgumentInfo

from pilotid import outputs
from pilotid.cli.running import StoppedError
from pilotid.disk import require_file, strict_json, write_file
from pilotid.estimates.method import Method
from pilotid.methods import label_of, method_named, methods
from pilotid.naming.settings import split_list
from pilotid.pilot.catalogue import AUTO, model_named
from pilotid.pilot.model import PilotModel
from pilotid.recordings.files import Reading, read_with
from pilotid.recordings.recording import LEAD_IN, Recording
from pilotid.types import FloatArray, InputError

SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers.")]
MethodOption = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="Method: arx, 'arx(memory=none)', file.py:CLASS; repeat, use commas, or say all.",
    ),
]
ScenarioOption = Annotated[
    list[str] | None,
    typer.Option(
        "--scenario",
        metavar="NAME",
        help="Scenario: nominal, 'nominal(runs=3)', file.py:NAME; repeat, use commas, or say all.",
    ),
]

ElementOption = Annotated[
    str | None,
    typer.Option(
        metavar="15/s^2",
        help="Controlled element, for the loops' margins; else the file's, or what u and x show.",
    ),
]

FilesArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="F.csv|F.mat ...",
        help="Recordings to read; F.mat::PART is one of several in a file.",
        readable=False,
    ),
]
ModelOption = Annotated[
    str,
    typer.Option(
        "--model",
        metavar="NAME|auto",
        help="Pilot model: single, multi (needs motion of the pilot), file.py:NAME for one of your "
        "own; auto takes the catalogue's best.",
    ),
]
JsonOption = Annotated[
    str | None,
    typer.Option("--json", metavar="F.json|-", help="Write the results as JSON; - prints."),
]
OutOption = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Results folder; what is done there is kept."),
]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes; default: one for each processor."),
]
MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="u=-stick,fd=3.5*d",
        help="The file's names for t, e, u, x, ft, fd; a sign or a factor before one is applied.",
    ),
]
JointOption = Annotated[
    bool, typer.Option("--joint", help="Take all files as runs of one recording.")
]
IntervalOption = Annotated[
    float | None,
    typer.Option("--dt", metavar="0.01", help="Sampling interval [s] of files without times."),
]
DetrendOption = Annotated[
    bool, typer.Option("--detrend", help="Take a straight line out of u, run by run, and say so.")
]
LeadInOption = Annotated[
    float,
    typer.Option(
        "--lead-in",
        metavar="S",
        help="Seconds that are not scored before the first sample that is; a run-in counts.",
    ),
]

FixOption = Annotated[
    str | None,
    typer.Option(
        "--fix",
        metavar="fnm=12,dnm=.1..0.5",
        help="Parameters held at a value, or searched between others.",
    ),
]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Write over files that pilotid did not write.")
]
PlotOption = Annotated[
    bool,
    typer.Option("--plot", help="Open the report, or draw in the terminal without a display."),
]
IgnoreOption = Annotated[
    list[str] | None,
    typer.Option(
        "--ignore", metavar="CODE", help="Code of a warning that is left out; repeat, or commas."
    ),
]
RunsOption = Annotated[
    str | None, typer.Option("--runs", metavar="2-5", help="The runs to use, as in 2-5 or 1,3.")
]
SpanOption = Annotated[
    str | None,
    typer.Option("--span", metavar="0:41", help="The seconds of the window to use, START:END."),
]

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


def default_method() -> str:
    """The method of a fit where none is named."""
    return "mle" if "mle" in methods() else "mle-white"


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
    outputs.require_free(named, read_with(inputs), force=force)


def recordings_of(
    files: Sequence[Path],
    mapping: Sequence[str] | None,
    dt: float | None,
    detrend: bool,
    lead_in: float = LEAD_IN,
    runs: str | None = None,
    span: str | None = None,
    *,
    joint: bool,
) -> tuple[list[Recording], list[str]]:
    """The recordings in files, and a sentence for each file that cannot be used."""
    reading = Reading(tuple(mapping or ()), dt, detrend, lead_in, runs or "", span or "")
    return reading.all(files, joint=joint)


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


def typed_command(command: Callable[..., None], given: Mapping[str, object]) -> str:
    """The command that does the same again: its arguments, and the options that differ."""
    first, rest = [], []
    parameters = signature(command, eval_str=True).parameters.values()
    for parameter in sorted(parameters, key=lambda each: each.name == "out"):
        value, known = given[parameter.name], parameter.annotation.__metadata__[0]
        values = [str(v) for v in value] if isinstance(value, list) else [str(value)]
        if isinstance(known, ArgumentInfo):
            first += [] if value is None else values
        elif value is not None and value != parameter.default:
            declared = known.param_decls or (f"--{parameter.name.replace('_', '-')}",)
            rest += [w for v in values for w in (declared[0], *([] if value is True else [v]))]
    return shlex.join(["pilotid", command.__name__, *first, *rest])
