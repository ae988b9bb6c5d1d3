"""The commands on studies: `compare` and `report`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pilotid.cli.arguments import MethodOption, ScenarioOption, SeedOption, names_of
from pilotid.cli.stopping import StoppedError
from pilotid.cli.trust import LikeOption, scenario_like
from pilotid.seeds import DEFAULT_SEED
from pilotid.terminal import make_console
from pilotid.types import InputError

if TYPE_CHECKING:
    from pilotid.study.store import Store
    from pilotid.study.study import Pending

SalvageOption = Annotated[
    bool,
    typer.Option(
        "--salvage", help="If the store is damaged, put a new one with all that is whole there."
    ),
]


def compare(
    profile: Annotated[
        str,
        typer.Option(
            metavar="quick|full",
            help="quick: some recordings of the nominal scenario and of any pilot; full: 500 of "
            "every scenario and population.",
        ),
    ] = "quick",
    scenario: ScenarioOption = None,
    like: LikeOption = None,
    method: MethodOption = None,
    replications: Annotated[
        int | None, typer.Option(min=1, help="Recordings of each scenario.")
    ] = None,
    seed: SeedOption = DEFAULT_SEED,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: one for each processor.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Use the workers of this Dask scheduler instead."),
    ] = None,
    time_limit: Annotated[
        float,
        typer.Option(metavar="S", help="Seconds that a fit may take; 0 for no limit."),
    ] = 600.0,
    memory: Annotated[
        float,
        typer.Option(metavar="GB", help="Address space of each process; 0 for no limit."),
    ] = 4.0,
    retry_failed: Annotated[
        bool,
        typer.Option(
            "--retry-failed",
            help="Fit again what crashed, died, or ran out of memory or time.",
        ),
    ] = False,
    salvage: SalvageOption = False,
    mix: Annotated[
        bool, typer.Option("--mix", help="Add to results of other code or settings in DIR.")
    ] = False,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the results; goes on where it stopped.")
    ] = Path("results/compare"),
) -> None:
    """Compare methods on simulated recordings whose truth is known."""
    from pilotid.cli.progress import with_progress
    from pilotid.datasets import CATALOGUE
    from pilotid.disk import make_folder
    from pilotid.jobs import Limits
    from pilotid.methods import methods
    from pilotid.study.store import Store
    from pilotid.study.study import PROFILES, Study

    if profile not in PROFILES:
        raise InputError(f"unknown profile '{profile}': choose from {', '.join(PROFILES)}")
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler exclude each other; leave one out")
    for option, number in (("--time-limit", time_limit), ("--memory", memory)):
        if not 0.0 <= number < math.inf:
            raise InputError(f"{option} {number}: must be a number of at least 0")
    default, count = PROFILES[profile]
    like_it = [] if like is None else [scenario_like(like, seed)]
    study = Study(
        [*like_it, *names_of(scenario, () if like_it else default, list(CATALOGUE))],
        names_of(method, list(methods()), list(methods())),
        replications or count,
        seed,
        sparing=method is None,
    )
    make_folder(out)
    if salvage:
        _salvage(out)
    with Store(out, create=True) as store:
        try:
            pending = study.enter(store, mix=mix, retry=retry_failed)
            held = study.size - pending.total
            if held:
                words = f"{store.path}: holds {held} of {study.size} fits already"
                make_console().print(words, soft_wrap=True)
            limits = Limits(time_limit or None, memory or None)
            results = study.run(store, pending, workers, scheduler, limits)
            for number, _ in enumerate(with_progress(results, pending.counts), start=1):
                if number == len(pending.counts):  # one fit by each tells how long all will take
                    _foretell(store, pending, workers)
            _finish(out, store)
        except KeyboardInterrupt:
            raise StoppedError(
                f"stopped; {store.path} keeps what is done, and the same command goes on from there"
            ) from None


def _foretell(store: Store, pending: Pending, workers: int | None) -> None:
    """Say about how long a long study will take."""
    from pilotid.jobs import processors
    from pilotid.study.study import remaining_seconds

    processes = workers or processors()
    minutes = remaining_seconds(store, pending.counts, processes) / 60.0
    days = minutes / 1440.0
    long = f"{minutes:.0f} min" if days < 2.0 else f"{days:.0f} days"
    if minutes > 1.0:
        make_console(errors=True).print(
            f"{pending.total} fits, about {long} on {processes} processes", soft_wrap=True
        )


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="What `compare` wrote.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Another folder for the report, if DIR is read-only."),
    ] = None,
    keep: Annotated[
        bool,
        typer.Option(
            "--keep", help="Write all rows in a small form too, and make the report from that."
        ),
    ] = False,
    salvage: SalvageOption = False,
) -> None:
    """Make the tables and the report of a comparison again, from its store alone."""
    from pilotid.disk import make_folder
    from pilotid.study.store import Store

    target = out or folder
    if salvage:
        _salvage(folder)
    with Store(folder) as store:
        if out is not None:
            make_folder(out)
        if not keep:
            _finish(target, store)
            return
        path = store.keep(target)
    with Store(target, small=True) as store:
        _finish(target, store)
    make_console().print(f"rows: {path}", soft_wrap=True)


def _salvage(folder: Path) -> None:
    from pilotid.study.store import salvage

    make_console(errors=True).print(f"pilotid: {salvage(folder)}", soft_wrap=True)


def _finish(folder: Path, store: Store) -> None:
    from pilotid.document import Bullets, print_blocks
    from pilotid.report.study import compared, overview, write_report
    from pilotid.study.comparison import comparison_of

    study = comparison_of(store)
    study.write_tables(folder)
    path = write_report(folder, store, study)
    words, tables = overview(study, widest=5 if len(compared(study)) <= 5 else 0)
    print_blocks(make_console(), *tables, Bullets([*words, f"report: {path}"]))
