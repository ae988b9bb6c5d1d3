"""The command `design`."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pilotid.cli.options import numbers_in, typed_command
from pilotid.outputs import require_folder
from pilotid.seeds import DEFAULT_SEED
from pilotid.terminal import make_console
from pilotid.types import InputError

if TYPE_CHECKING:
    from pilotid.datasets.scenarios import Scenario
    from pilotid.pilot.model import PilotModel


def design(
    scenario: str | None = None,
    *,
    out: Path,
    minimise: str = "A",
    wanted: str | None = None,
    limit: str = "e=1,u=1",
    at_most: float | None = None,
    lines: int | None = None,
    pick: Literal["any", "odd", "prime"] = "any",
    period: float | None = None,
    seconds: float | None = None,
    runs: int | None = None,
    truth: str | None = None,
    estimates: Path | None = None,
    pilots: int | None = None,
    over: Literal["mean", "worst"] = "mean",
    power: str | None = None,
    subjects: int = 8,
    between: float = 0.1,
    within: float = 0.05,
    rate: float | None = None,
    fade: float = 2.0,
    shared: bool = False,
    model: str | None = None,
    remnant: Literal["held", "share"] = "held",
    seed: int = DEFAULT_SEED,
    force: bool = False,
) -> None:
    """Design forcing functions and recording time for the precision wanted."""
    given = dict(locals())
    from importlib.metadata import version

    from pilotid.datasets.named import model_place
    from pilotid.designing import design as designing
    from pilotid.designing.limits import Limits
    from pilotid.designing.lines import chosen_lines, reference_lines
    from pilotid.designing.output import write_files
    from pilotid.designing.pilots import drawn_pilots
    from pilotid.designing.planning import plan, read_effect
    from pilotid.designing.report import print_design, write_report
    from pilotid.naming.settings import configured
    from pilotid.pilot.catalogue import model_named

    read = [Path(path) for path in (scenario, estimates) if path is not None]
    require_folder(out, ("design.json", "forcing.csv", "report.html"), read, force=force)
    own = model_named(model) if model is not None else None
    if estimates is not None and pilots is not None:
        raise InputError("--from and --pilots exclude each other; leave one out")
    known = _references(scenario, estimates, own)
    everyone = [
        _changed(each, own if estimates is None else None, truth, seconds, runs) for each in known
    ]
    chosen = everyone[0]
    if pilots is not None:
        everyone = drawn_pilots(chosen, pilots, seed)
    effect = read_effect(power) if power else ()
    with make_console(errors=True).status("designing"):
        made = designing.design(
            chosen,
            minimise,
            wanted=numbers_in("--wanted", wanted) if wanted else None,
            limits=configured(Limits, limit, f"--limit {limit}"),
            lines=chosen_lines(reference_lines(chosen), lines, pick, period, shared=shared),
            pilots=everyone if pilots is not None or len(everyone) > 1 else (),
            over=over,
            remnant=remnant,
            at_most=at_most,
            seed=seed,
        )
    experiments = {"design": made.scenario, "reference": made.reference} if effect else {}
    plans = [
        (name, plan(experiment, *effect, between=between, within=within))
        for name, experiment in experiments.items()
    ]

    command = typed_command(design, given)
    about = {
        "pilotid": version("pilotid"),
        "command": command,
        "plan": {name: asdict(found) for name, found in plans} or None,
    }
    write_files(out, made, about, rate, fade, model or model_place(scenario or ""))
    page = write_report(out, made, command, version("pilotid"), plans, subjects)
    print_design(made, plans, subjects)
    console = make_console()
    console.print(f"design: {out / 'design.json'}, signals: {out / 'forcing.csv'}", soft_wrap=True)
    console.print(f"report: {page}", soft_wrap=True)


def _references(
    name: str | None, estimates: Path | None, model: PilotModel | None
) -> list[Scenario]:
    """The scenario of that name, or those of the pilots in a file of estimates."""
    from pilotid.datasets import Scenario, scenario_named
    from pilotid.designing.pilots import studied

    if estimates is not None and name is None:
        return studied(None, estimates, model)
    chosen = scenario_named(name or "nominal")
    if not isinstance(chosen, Scenario):
        raise InputError(
            f"{name}: is a population; a design is for one loop: name a scenario, and --pilots for "
            "pilots of the populations' ranges in it"
        )
    if chosen.violation is not None:
        raise InputError(
            f"scenario {chosen.name}: a design cannot be made for what methods break on"
        )
    return [chosen] if estimates is None else studied(chosen, estimates, model)


def _changed(
    chosen: Scenario,
    model: PilotModel | None,
    truth: str | None,
    seconds: float | None,
    runs: int | None,
) -> Scenario:
    """A scenario with another model, truth, window or number of runs."""
    from pilotid.designing.lines import with_held_remnant
    from pilotid.designing.pilots import with_truth

    values = {} if truth is None else numbers_in("--truth", truth)
    if model is not None or values:
        chosen = with_truth(chosen, values, model)
    if seconds is not None:
        chosen = replace(with_held_remnant(chosen), duration=seconds, family="", varied="")
    return replace(chosen, runs=runs or chosen.runs)
