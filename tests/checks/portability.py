"""The tests as other processors would run them, with one thread and with two.

    nox -s portability                   the whole suite, on every processor that can be had
    nox -s portability -- --numerical    what computes, on every processor
    nox -s portability -- --quick        half of what computes, in parts on two that are not this

A quick run takes every other file, and leaves out what is marked `long`: averages over many fits
or draws, remarks on many recordings, and commands.  What a processor does to one fit is in shorter
tests of the same code.

What follows goes to pytest.
"""

from __future__ import annotations

import argparse
import itertools
import os
import subprocess
import sys
from pathlib import Path

from processors import Processor, is_native, runnable

THREADS = (1, 2)
TESTS = Path(__file__).parents[1]


Run = tuple[Processor, int, tuple[str, ...]]  # on what, with how many threads, which files


def quick(processors: list[Processor]) -> list[Run]:
    """Two runs: processors that this is not where there are such, and both thread counts.

    Of every other file a fourth goes to the second, which runs one test at a time.
    """
    others_first = sorted(processors, key=is_native)
    files = [str(path) for path in sorted(TESTS.glob("test_*.py"))]
    computing = [name for name in files if "mark.numerical" in Path(name).read_text("utf-8")][::2]
    second = computing[3::4]
    parts = ([name for name in computing if name not in second], second)
    return [
        (processor, threads, tuple(part))
        for processor, threads, part in zip(
            itertools.cycle(others_first), THREADS, parts, strict=False
        )
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--numerical", action="store_true", help="leave out what does not compute")
    parser.add_argument("--quick", action="store_true", help="its shorter tests, in two runs")
    settings, more = parser.parse_known_args()
    processors, sentences = runnable()
    print("\n".join(sentences), flush=True)
    every = [(*pair, ()) for pair in itertools.product(processors, THREADS)]
    part = ("-m", "numerical") if settings.numerical else ()
    if settings.quick:
        part = ("-m", "numerical and not long")
    pytest = (sys.executable, "-m", "pytest", "-q", "--ignore=tests/benchmarks")
    results = {}
    for processor, threads, files in quick(processors) if settings.quick else every:
        title = f"{processor.name}, {threads} thread{'s' if threads > 1 else ''}"
        print(f"\n--- {title}", flush=True)
        # Threads that wait for one another's processor take longer than one after the other.
        workers = ("-n", str(max(1, (os.cpu_count() or 1) // threads)), "--dist", "worksteal")
        environment = processor.environment(threads)
        done = subprocess.run((*pytest, *workers, *part, *more, *files), env=environment)
        results[title] = "passed" if done.returncode == 0 else f"failed ({done.returncode})"
    print("\n" + "\n".join(f"{title}: {result}" for title, result in results.items()))
    sys.exit(int(any(result != "passed" for result in results.values())))


if __name__ == "__main__":
    main()
