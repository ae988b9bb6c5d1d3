"""The processors whose arithmetic this machine can do.

Three libraries look at the processor and choose among several versions of their innermost
loops, which add in different orders and so round differently: OpenBLAS (products of matrices,
factorisations), numpy (exponentials, logarithms, powers) and the C library (sines).  A
`Processor` makes all three choose in a child process as they would on another machine.

    python tests/checks/processors.py     says which of them this machine can run
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

OLDER = "AVX512", "X86_V4"  # what numpy calls extensions that came after Haswell
OLDEST = "AVX", "F16C", "FMA", "X86_V3", "X86_V4"  # ... and after Prescott


@dataclass(frozen=True)
class Processor:
    """A kind of processor, by the name that ``OPENBLAS_CORETYPE`` takes.

    Attributes
    ----------
    name
        The name, or ``native`` for whatever is in the machine.
    needs
        What /proc/cpuinfo must list among the flags to run its kernels.
    reported
        What OpenBLAS may call the kernels that it then uses.
    lacks
        Beginnings of the names of what numpy must do without.
    libc
        What the C library must do without.
    """

    name: str
    needs: tuple[str, ...] = ()
    reported: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()
    libc: str = ""

    def environment(self, threads: int) -> dict[str, str]:
        """Environment variables of a child process that computes as this processor does."""
        count = str(threads)
        chosen = {"OMP_NUM_THREADS": count, "OPENBLAS_NUM_THREADS": count}
        if self.name != NATIVE.name:
            chosen["OPENBLAS_CORETYPE"] = self.name
            found = [f for f in probe(NATIVE)["simd"] if f.startswith(self.lacks)]
            if self.lacks and found:
                chosen["NPY_DISABLE_CPU_FEATURES"] = ",".join(found)
            if self.libc:
                chosen["GLIBC_TUNABLES"] = f"glibc.cpu.hwcaps={self.libc}"
        return {**os.environ, **chosen}


NATIVE = Processor("native")
PROCESSORS = (
    Processor("Haswell", ("avx2", "fma"), ("Haswell",), OLDER),
    Processor("SkylakeX", ("avx512f", "avx512bw", "avx512dq", "avx512vl"), ("SkylakeX",)),
    Processor("Zen", ("avx2", "fma"), ("Zen", "Haswell"), OLDER),
    Processor("Prescott", ("pni",), ("Prescott", "Katmai"), OLDEST, "-AVX2,-FMA"),
)

PROBE = """
import json
import numpy, scipy.linalg
from threadpoolctl import threadpool_info
blas = [found for found in threadpool_info() if found["user_api"] == "blas"]
simd = numpy.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
print(json.dumps({
    "library": sorted({found["internal_api"] for found in blas}),
    "kernels": sorted({found.get("architecture") or "unknown" for found in blas}),
    "threads": sorted({found["num_threads"] for found in blas}),
    "simd": simd,
}))
"""


@cache
def probe(processor: Processor) -> dict[str, Any]:
    """What numpy and its BLAS say about themselves in a child process of one thread."""
    done = subprocess.run(
        [sys.executable, "-c", PROBE],
        env=processor.environment(threads=1),
        capture_output=True,
        text=True,
        check=True,
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def flags() -> set[str]:
    """What the processor can do, as Linux lists it; empty elsewhere."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    listed = [line.partition(":")[2].split() for line in lines if line.startswith("flags")]
    return set(listed[0]) if listed else set()


def runnable() -> tuple[list[Processor], list[str]]:
    """Processors whose arithmetic differs and can be had here, and a sentence on each other.

    OpenBLAS is asked whether it took the kernels that it was told to take.
    """
    found: list[Processor] = []
    sentences = []
    taken: dict[str, str] = {}
    here, own = flags(), probe(NATIVE)
    if own["library"] != ["openblas"]:
        library = " and ".join(own["library"]) or "unknown"
        return [NATIVE], [f"only this processor's own kernels: the BLAS is {library}, not OpenBLAS"]
    for processor in PROCESSORS:
        missing = [flag for flag in processor.needs if flag not in here]
        if missing:
            sentences.append(f"{processor.name}: not run, this processor has no {missing[0]}")
            continue
        answer = probe(processor)
        kernels = ", ".join(answer["kernels"])
        left = [f for f in answer["simd"] if processor.lacks and f.startswith(processor.lacks)]
        if not set(answer["kernels"]) <= set(processor.reported) or answer["threads"] != [1]:
            sentences.append(f"{processor.name}: not run, OpenBLAS took its {kernels} kernels")
        elif left:
            sentences.append(f"{processor.name}: not run, numpy would not do without {left[0]}")
        elif kernels in taken:
            sentences.append(
                f"{processor.name}: not run again, OpenBLAS takes the same kernels as for "
                f"{taken[kernels]}"
            )
        else:
            taken[kernels] = processor.name
            found.append(processor)
            by_itself = ", as by itself" if is_native(processor) else ""
            sentences.append(f"{processor.name}: OpenBLAS takes its {kernels} kernels{by_itself}")
    return found or [NATIVE], sentences


def is_native(processor: Processor) -> bool:
    """Whether this machine computes like that by itself."""
    return processor is NATIVE or probe(processor)["kernels"] == probe(NATIVE)["kernels"]


if __name__ == "__main__":
    print("\n".join(runnable()[1]))
