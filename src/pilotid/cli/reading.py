"""Options of commands that read recordings."""

from __future__ import annotations

from typing import Annotated

import typer

MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="u=stick,e=err",
        help="The file's names for t, e, u, x, ft, fd; a minus before one flips its sign.",
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
