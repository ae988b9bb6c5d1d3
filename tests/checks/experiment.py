"""Every number of an experiment's tables worked out again from the raw files, without pilotid.

    PILOTID_MEASURED=FOLDER nox -s check -- experiment [OUT]

FOLDER has the recordings of the yaw experiment in `yaw`.  OUT is a folder that `analyse` wrote from
them with `--factors` as below; without it the command is run.  Variances and their parts follow
from the signals, contrasts and effects of factors from estimates.csv and loops.csv; printed is the
largest relative difference of each column.
"""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import product
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pandas as pd
from scipy import stats
from scipy.io import loadmat

FACTORS = "dynamics=C1,C4:gain;C2,C5:single;C3,C6:double;motion=C1,C2,C3:off;C4,C5,C6:on"
CELLS = np.array([["C1", "C4"], ["C2", "C5"], ["C3", "C6"]])  # dynamics by motion
TOLERANCE = 1e-8


def analysed() -> Path:
    """A folder of results."""
    if len(sys.argv) > 1:
        return Path(sys.argv[1])
    out = mkdtemp()
    files = sorted(Path(os.environ["PILOTID_MEASURED"], "yaw").glob("*.mat"))
    pattern = ("--pattern", "subj{subject}_{condition}", "--factors", FACTORS)
    start = (sys.executable, "-c", "from pilotid.cli import start; start()")
    subprocess.run((*start, "analyse", *files, *pattern, "--out", out), check=True)
    return Path(out)


def forcing_lines(signal: np.ndarray) -> np.ndarray:
    """The frequencies of a sum of sines, as multiples of the lowest of the window."""
    size = np.abs(np.fft.rfft(signal - signal.mean()))
    return np.flatnonzero(size > 1e-3 * size.max())


def parts(file: str) -> dict[str, float]:
    """Variances of e, u and x in a file, and what each forcing function has of them."""
    held, found = loadmat(file), {}
    phases = {}
    for source, name in (("target", "ft"), ("disturbance", "fd")):
        spectrum, at = np.fft.rfft(held[name][:, 0]), forcing_lines(held[name][:, 0])
        phases[source] = at, spectrum[at] / np.abs(spectrum[at])
    for name in "eux":
        runs = held[name].T
        found[f"var_{name}"] = rest = float(np.mean(runs.var(axis=1)))
        found[f"rms_{name}"] = float(np.mean(np.sqrt(np.mean(runs**2, axis=1))))
        coefficients = np.fft.rfft(runs) / runs.shape[1]
        for source, (at, phase) in phases.items():
            own = coefficients[:, at] / phase
            pairs = [
                2.0 * np.sum((own[i] * own[j].conj()).real)
                for i, j in product(range(len(own)), repeat=2)
                if i != j
            ]
            found[f"var_{name}_{source}"] = float(np.mean(pairs))
            rest -= found[f"var_{name}_{source}"]
        found[f"var_{name}_remnant"] = rest
    return found


def counted(out: Path) -> pd.DataFrame:
    """Estimates and loops of all runs together that count."""
    loops = pd.read_csv(out / "loops.csv", dtype={"subject": str})
    estimates = pd.read_csv(out / "estimates.csv", dtype={"subject": str})
    every = pd.concat([estimates, loops.rename(columns={"quantity": "parameter"})])
    every = every[every["run"].isna()].fillna({"model": "", "remarks": ""})
    return every[~every["remarks"].str.startswith("not counted")]


def tested(a: np.ndarray, b: np.ndarray) -> dict[str, float]:
    """The paired test by its textbook formulas."""
    apart, n = b - a, len(a)
    mean, error = apart.mean(), apart.std(ddof=1) / np.sqrt(n)
    t = mean / error
    walsh = [0.5 * (apart[i] + apart[j]) for i in range(n) for j in range(i, n)]
    reach = stats.t.ppf(0.975, n - 1) * error
    return {
        "subjects": n, "mean_a": a.mean(), "mean_b": b.mean(), "difference": mean,
        "std_error": error, "t": t, "freedom": n - 1, "p": 2.0 * stats.t.sf(abs(t), n - 1),
        "lower_95": mean - reach, "upper_95": mean + reach, "robust_difference": np.median(walsh),
        "wilcoxon_p": stats.wilcoxon(apart).pvalue,
    }  # fmt: skip


def anova(table: np.ndarray) -> dict[str, float]:
    """F of dynamics, motion and both by sums of squares; shape (subjects, dynamics, motion)."""
    n, a, b = table.shape
    grand = table.mean()

    def centred(*kept: int) -> np.ndarray:
        """Means over the other axes less all means of fewer axes."""
        drop = tuple(axis for axis in range(3) if axis not in kept)
        return table.mean(axis=drop, keepdims=True) if drop else table

    s, d, m = centred(0) - grand, centred(1) - grand, centred(2) - grand
    sd, sm, dm = (
        centred(0, 1) - s - d - grand,
        centred(0, 2) - s - m - grand,
        centred(1, 2) - d - m - grand,
    )
    sdm = table - sd - sm - dm - s - d - m - grand
    sizes = {
        "dynamics": (d, sd, a - 1),
        "motion": (m, sm, b - 1),
        "dynamics:motion": (dm, sdm, (a - 1) * (b - 1)),
    }
    found = {}
    for name, (effect, error, freedom) in sizes.items():
        total = table.size / effect.size * np.sum(effect**2)
        left = table.size / error.size * np.sum(error**2)
        found[name] = (total / freedom) / (left / (freedom * (n - 1)))
    return found


def compare(worst: dict[str, float], column: str, told: float, known: float) -> None:
    """Keep the largest relative difference of a column."""
    if np.isnan(told) and np.isnan(known):
        return
    apart = abs(told - known) / max(abs(known), 1e-12)
    worst[column] = max(worst.get(column, 0.0), apart if apart == apart else np.inf)


def main() -> int:
    """Print the differences; 1 if one is larger than rounding."""
    out, worst = analysed(), dict[str, float]()
    every = counted(out)
    for file, own in every[every["method"] == "measured"].groupby("file"):
        known = parts(file)
        for row in own.itertuples():
            if row.parameter in known:
                compare(worst, "variances", row.value, known[row.parameter])
    values = every.set_index(["parameter", "method", "condition", "model", "subject"])[
        "value"
    ].sort_index()
    contrasts = pd.read_csv(out / "contrasts.csv").fillna({"model_a": "", "model_b": ""})
    for row in contrasts[contrasts["t"].notna()].to_dict("records"):
        ends = [
            (row["parameter"], row["method"], row[f"condition_{s}"], row[f"model_{s}"])
            for s in "ab"
        ]
        pair = pd.concat([values.loc[end] for end in ends], axis=1, join="inner").to_numpy()
        for column, known in tested(*pair.T).items():
            compare(worst, column, row[column], known)
    for _, own in contrasts.groupby(["method", "parameter"]):
        p = own["p"].dropna().sort_values()
        known, last = {}, 0.0
        for place, (index, value) in enumerate(p.items()):
            known[index] = last = max(last, min(1.0, (len(p) - place) * value))
        for index, value in known.items():
            compare(worst, "p_holm", own["p_holm"][index], value)
    models = pd.read_csv(out / "models.csv")
    chosen = models[models["chosen"] == "yes"].groupby("condition")["model"].first()
    effects = pd.read_csv(out / "factors.csv")
    for (method, parameter), own in effects[effects["F"].notna()].groupby(["method", "parameter"]):
        places = [
            (parameter, method, c, "" if method == "measured" else chosen[c]) for c in CELLS.ravel()
        ]
        table = pd.concat([values.loc[place] for place in places], axis=1, join="inner").to_numpy()
        known = anova(table.reshape(-1, *CELLS.shape))
        for row in own.itertuples():
            compare(worst, "F", row.F, known[row.effect])
            compare(worst, "p of F", row.p, stats.f.sf(row.F, row.df1, row.df2))
    for column, apart in worst.items():
        print(f"{column:20s} {apart:.1e}")
    return int(max(worst.values()) > TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
