"""The command `design`."""

from __future__ import annotations

from pathlib import Path

from pilotid.cli.options import numbers_in, typed_command
from pilotid.outputs import require_folder
from pilotid.terminal import make_console
from pilotid.types import InputError


def design(
    scenario: str | None = None,
    *,
    out: Path,
    minimise: str = "A",
    limit: str = "e=1,u=1",
    estimates: Path | None = None,
    force: bool = False,
) -> None:
    """Design forcing functions for small errors, within limits on error and control."""
    given = dict(locals())
    from importlib.metadata import version

    from pilotid.datasets import Population, scenario_named
    from pilotid.datasets.named import model_place
    from pilotid.designing.design import design as designed
    from pilotid.designing.design import scenario_of_fit, write_files
    from pilotid.designing.report import error_table, sentences, write_report
    from pilotid.document import Bullets, print_blocks

    read = [Path(path) for path in (scenario, estimates) if path is not None]
    require_folder(out, ("design.json", "forcing.csv", "report.html"), read, force=force)
    named = None if scenario is None and estimates else scenario_named(scenario or "nominal")
    if isinstance(named, Population) or (named and named.violation is not None):
        raise InputError(f"{named.name}: a design is for one sound loop; name a scenario")
    chosen = scenario_of_fit(estimates, named) if estimates else named
    assert chosen is not None
    with make_console(errors=True).status("designing"):
        made = designed(chosen, minimise, numbers_in("--limit", limit))
    command = typed_command(design, given)
    about = {"pilotid": version("pilotid"), "command": command}
    write_files(out, made, about, model_place(scenario or ""))
    page = write_report(out, made, command)
    print_blocks(make_console(), error_table(made), Bullets([*sentences(made), f"report: {page}"]))
