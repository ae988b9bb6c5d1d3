"""The command `analyse`."""

from __future__ import annotations

from pathlib import Path

from pilotid.cli import options
from pilotid.recordings.files import Reading
from pilotid.support.document import print_blocks
from pilotid.support.numbers import DEFAULT_SEED
from pilotid.support.terminal import make_console


def analyse(
    files: list[Path],
    *,
    out: Path,
    pattern: str | None = None,
    model: list[str] | None = None,
    method: list[str] | None = None,
    contrast: list[str] | None = None,
    model_per_condition: bool = False,
    per_run: bool = False,
    left_out: bool = False,
    reading: Reading,
    exclude: list[str] | None = None,
    factors: str | None = None,
    element: str | None = None,
    fix: str | None = None,
    ignore: list[str] | None = None,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
    force: bool = False,
) -> None:
    """Analyse a laboratory's recordings: subjects, conditions, runs; tables and a report."""
    given = dict(locals())
    from pilotid.analysis.experiment import analyse as analysed
    from pilotid.pilot.catalogue import AUTO

    with options.resumable(out):
        found = analysed(
            files,
            pattern,
            options.names_of(model, [AUTO], [AUTO]),
            list(options.methods_of(method, [options.default_method()]).values()),
            out=out,
            contrasts=contrast or (),
            model_per_condition=model_per_condition,
            per_run=per_run,
            left_out=left_out,
            exclude=exclude or (),
            factors=factors,
            element=element,
            fix=fix,
            reading=reading,
            ignore=ignore or (),
            seed=seed,
            workers=workers,
            force=force,
        )
    path = found.write(options.typed_command(analyse, given))
    print_blocks(make_console(), *found.blocks(path))
    options.raise_refused(found.refused)
