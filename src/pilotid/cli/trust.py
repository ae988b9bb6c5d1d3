"""The command `trust`, and scenarios made of recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pilotid.cli.arguments import ElementOption, MethodOption, SeedOption, names_of
from pilotid.cli.reading import DetrendOption, IntervalOption, MapOption
from pilotid.cli.stopping import StoppedError
from pilotid.pilot.catalogue import AUTO, model_named
from pilotid.pilot.element import element_named
from pilotid.recordings.files import Reading
from pilotid.seeds import DEFAULT_SEED
from pilotid.terminal import make_console

if TYPE_CHECKING:
    from pilotid.datasets import Scenario
    from pilotid.pilot.model import PilotModel
    from pilotid.recordings.recording import Recording

LikeOption = Annotated[
    Path | None,
    typer.Option(
        "--like",
        metavar="FILE",
        help="The scenario of a recording as mle fits it, or of the trust.json of `trust`.",
    ),
]


def scenario_like(path: Path, seed: int) -> Scenario:
    """The scenario of a recording, or the one in a `trust.json`."""
    from pilotid.datasets.named import designed_scenario
    from pilotid.study.trust import trial_of

    if path.suffix.lower() == ".json":
        return designed_scenario(path)
    recording = Reading().all([path], joint=False)[0][0]
    return trial_of(recording, _model(recording, AUTO, seed), ["mle"], seed).scenario


def _model(recording: Recording, name: str, seed: int) -> PilotModel:
    from pilotid.analysis.choice import select

    return select(recording, seed=seed).model if name == AUTO else model_named(name)


def trust(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="F.csv|F.mat", help="Recording; several are runs of one."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the results; goes on where it stopped.")
    ],
    model: Annotated[
        str, typer.Option(metavar="NAME|auto", help="Pilot model; auto takes the best.")
    ] = AUTO,
    method: MethodOption = None,
    replications: Annotated[int, typer.Option(min=1, help="Simulations of the recording.")] = 40,
    mapping: MapOption = None,
    dt: IntervalOption = None,
    detrend: DetrendOption = False,
    element: ElementOption = None,
    seed: SeedOption = DEFAULT_SEED,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: one for each processor.")
    ] = None,
) -> None:
    """Compare methods on simulations of a recording, and correct the intervals of its fit.

    The first method that is named is the one whose fit is judged, else mle.
    """
    from pilotid.cli.progress import with_progress
    from pilotid.datasets.named import model_place
    from pilotid.document import Bullets, print_blocks
    from pilotid.methods import methods
    from pilotid.report.study import overview, write_report
    from pilotid.report.trust import advice, trust_table
    from pilotid.study.store import Store
    from pilotid.study.trust import TRUST, UNKNOWN, trial_of

    recordings, _ = Reading(tuple(mapping or ()), dt, detrend).all(files, joint=len(files) > 1)
    recording = recordings[0]
    if element is not None:
        recording = replace(recording, controlled_element=element_named(element).name)
    chosen = _model(recording, model, seed)
    trial = trial_of(recording, chosen, names_of(method, [], list(methods())), seed)
    try:
        found = trial.run(out, replications, seed, workers, model_place(model), with_progress)
    except KeyboardInterrupt:
        raise StoppedError(
            f"stopped; {out} keeps what is done, and the same command goes on from there"
        ) from None
    with Store(out) as store:
        page = write_report(out, store, found.comparison)
    told = found.to_dict()
    words, tables = overview(found.comparison)
    written = f"scenario and numbers: {out / TRUST}, report: {page}"
    sentences = Bullets([*words, *advice(told), UNKNOWN, written])
    print_blocks(make_console(), *tables, trust_table(told), sentences)
