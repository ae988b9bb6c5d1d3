"""Changes bytes in finished stores: nothing but the truth may come out of them.

Each store is read as `report` does, opened as `compare` does, and salvaged; it ends whole, kept
in part, or refused in a sentence.  Anything else is a fault and ends with status 1.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stores import changed, content_of, finish, outcome

from pilotid.study.store import STORE, Store


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stores", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    counts: Counter[str] = Counter()
    faults: list[str] = []
    slowest = 0.0
    with TemporaryDirectory() as name:
        folder = Path(name) / "whole"
        folder.mkdir()
        finish(folder).close()
        with_truth = (folder / STORE).read_bytes()
        with Store(folder) as store:
            whole = content_of(store)
        for number in range(options.stores):
            tried = Path(name) / str(number)
            tried.mkdir()
            (tried / STORE).write_bytes(changed(with_truth, rng))
            start = time.perf_counter()
            try:
                counts[outcome(tried, whole)] += 1
            except Exception as error:  # any at all is what this looks for
                faults.append(f"store {number}: {type(error).__name__}: {error}")
            slowest = max(slowest, time.perf_counter() - start)
    for fault in faults:
        print(fault)
    print(", ".join(f"{n} {kind}" for kind, n in sorted(counts.items())))
    many = f"{options.stores} damaged stores, {len(faults)} faults"
    print(f"{many}; the slowest took {slowest:.1f} s")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
