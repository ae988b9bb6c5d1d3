"""Changes bytes in finished stores: nothing but the truth may come out of them.

Each store is read as `report` does and mended as `compare` does; it ends whole, kept in part
with a warning, or refused in a sentence.  Anything else is a fault and ends with status 1.
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
    counts: Counter[tuple[bool, str]] = Counter()
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
            content = changed(with_truth, rng)
            for create in (False, True):
                tried = Path(name) / f"{number}{create}"
                tried.mkdir()
                (tried / STORE).write_bytes(content)
                start = time.perf_counter()
                try:
                    counts[create, outcome(tried, whole, create=create)] += 1
                except Exception as error:  # any at all is what this looks for
                    faults.append(f"store {number}: {type(error).__name__}: {error}")
                slowest = max(slowest, time.perf_counter() - start)
    for fault in faults:
        print(fault)
    for create, what in ((False, "read"), (True, "mended")):
        ends = [(kind, n) for (how, kind), n in sorted(counts.items()) if how is create]
        print(f"{what}: {', '.join(f'{n} {kind}' for kind, n in ends)}")
    many = f"{options.stores} damaged stores, {len(faults)} faults"
    print(f"{many}; the slowest took {slowest:.1f} s")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
