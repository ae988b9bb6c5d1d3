"""Curves of pilots who change freely, against truth: `nox -s check -- adapting-free`.

For each scenario and model the trajectory by `mle`: its bias, its error and what it claims over
time, as shares of the truth on the logarithmic scale, how much of the time its band holds the
truth, and the parameters that stay.  `--measured` fits recordings of pilots who change, all runs
of a condition jointly, with a sigmoid and with curves, and draws both (PILOTID_MEASURED names
the folder above them).
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from pilotid.chance import Z95
from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import identify
from pilotid.methods import method_named
from pilotid.pilot.catalogue import ADAPTING, ADAPTING_FREE, SINGLE
from pilotid.recordings.files import load_recording
from pilotid.seeds import fit_rng
from pilotid.types import FloatArray

#: A pilot who stays, of an element that stays.
CONSTANT = replace(
    SCENARIOS["adapting-slow"],
    name="constant",
    truth=(0.08, 0.08, 0.7, 0.7, 41.92, 0.5, 0.28, 11.25, 0.35),
    change=None,
)
PILOTS = {s.name: s for s in (CONSTANT, SCENARIOS["adapting-slow"], SCENARIOS["adapting-fast"])}
STILL = ("tdvis", "fnm", "dnm")


def shown(scenario: Scenario, model: str, fits: list[Estimate]) -> None:
    """Print what a model's trajectories are worth."""
    usable = [e for e in fits if e.outcome.usable]
    seconds = np.median([e.seconds for e in fits])
    print(
        f"\n{scenario.name}, {model}: {len(usable)} of {len(fits)} usable, {seconds:.1f} s a fit; "
        "% of the truth"
    )
    paths = [e.trajectory for e in usable if e.trajectory is not None]
    if model == SINGLE.name or not paths:
        rows = []
    else:
        truth = scenario.model.over_time(scenario.values, paths[0].time)
        rows = [*enumerate(paths[0].keys[:2])]
        print("curve      bias   rmse +- %    claimed  coverage +-")
    for i, key in rows:
        off = np.array([np.log(path.values[i] / truth[i]) for path in paths])
        claimed = [np.log(path.upper[i] / path.lower[i]) / (2.0 * Z95) for path in paths]
        inside = np.array(
            [np.mean((p.lower[i] <= truth[i]) & (truth[i] <= p.upper[i])) for p in paths]
        )
        squares, count = np.mean(off**2, axis=1), len(paths)
        rmse = np.sqrt(np.mean(squares))
        print(
            f"{key:<9}{_share(np.mean(off, axis=0)):>6.1f}{100.0 * rmse:>7.1f}"
            f"{50.0 * np.std(squares) / rmse / np.sqrt(count):>6.1f}"
            f"{_share(np.array(claimed)):>9.1f}{np.mean(inside):>9.3f}"
            f"{np.std(inside) / np.sqrt(count):>7.3f}"
        )
    print("parameter  bias +- %  scatter  claimed  coverage")
    plain = dict(zip(scenario.model.keys, scenario.values, strict=True))
    for key in STILL:
        found = [e[key] for e in usable]
        off = np.array([q.value for q in found]) / plain[key] - 1.0
        inside = np.array([q.lower <= plain[key] <= q.upper for q in found])
        error = np.mean([q.std_error for q in found]) / plain[key]
        print(
            f"{key:<9}{100.0 * np.mean(off):>6.1f}{100.0 * np.std(off) / np.sqrt(len(off)):>6.1f}"
            f"{100.0 * np.std(off):>8.1f}{100.0 * error:>9.1f}{np.mean(inside):>10.3f}"
        )


def _share(off: FloatArray) -> float:
    return float(100.0 * np.sqrt(np.mean(off**2)))


def measured(names: list[str], out: Path) -> None:
    """Fit recordings of pilots who change, and draw their courses."""
    import matplotlib.pyplot as plt

    folder = Path(os.environ["PILOTID_MEASURED"]) / "adaptation"
    figure, axes = plt.subplots(len(names), 2, squeeze=False, figsize=(9.0, 2.4 * len(names)))
    for name, pair in zip(names, axes, strict=True):
        recording = load_recording(folder / f"{name}.mat")
        for model, colour in ((ADAPTING, "#D55E00"), (ADAPTING_FREE, "#0072B2")):
            fit = identify(method_named("mle"), recording, model, fit_rng(1, model.name))
            print(f"{name}, {model.name}: {fit.verdict()}", flush=True)
            path = fit.trajectory
            if path is None:
                continue
            for i, panel in enumerate(pair):
                panel.plot(path.time, path.values[i], color=colour, label=model.name)
                panel.fill_between(path.time, path.lower[i], path.upper[i], color=colour, alpha=0.2)
                panel.set_title(f"{name}: {path.keys[i]}", loc="left", fontsize=8)
                panel.set_ylim(0.0, 2.0 * np.max(path.values[i]))
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(out)
    print(f"drawn in {out}")


def main() -> None:
    """Run what the options ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", nargs="*", default=[*PILOTS])
    parser.add_argument("--method", default="mle")
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--alone", action="store_true", help="adapting-free without the others")
    parser.add_argument("--beside", action="store_true", help="the others without adapting-free")
    parser.add_argument("--measured", nargs="*", help="files, for example pilot2_C5_pitch")
    parser.add_argument("--out", type=Path, default=Path("adapting-free.svg"))
    options = parser.parse_args()
    if options.measured:
        measured(options.measured, options.out)
        return
    method = method_named(options.method)
    for scenario in (PILOTS.get(name) or SCENARIOS[name] for name in options.scenario):
        beside = SINGLE if scenario is CONSTANT else ADAPTING
        models = [ADAPTING_FREE] * (not options.beside) + [beside] * (not options.alone)
        fits: dict[str, list[Estimate]] = {}
        for replication in range(options.recordings):
            seed = np.random.SeedSequence(options.seed, spawn_key=(replication,))
            recording = simulate(scenario, np.random.default_rng(seed))
            for model in models:
                rng = fit_rng(options.seed + replication, method.name)
                fits.setdefault(model.name, []).append(identify(method, recording, model, rng))
        for name, own in fits.items():
            shown(scenario, name, own)


if __name__ == "__main__":
    main()
