"""Change good recordings at random and see what reading them does.

    python tests/checks/fuzz_files.py [--files N] [--kinds csv,mat,v73] [--seed N]

A process of its own reads the files, within 1 GB of memory above what it starts with and 60 s a
file.  The table says how many were read and refused, with the commonest sentences; a crash, a
hang, too much memory, an exception that is no `InputError` and a recording that the changes do
not explain are failures, listed with the file's number and kept in the folder that --keep names.

What explains a recording that differs from the original: for CSV, a plain reader finds the same
numbers in the changed file; MATLAB files must keep the number of runs and samples.
"""

from __future__ import annotations

import argparse
import csv
import io
import multiprocessing as mp
import re
import struct
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

SAMPLES, DT = 240, 0.05
MEMORY = 2**30  # bytes above those of a process that has read a good file
SECONDS = 60.0
SIGNALS = ("e", "u", "x", "ft", "fd")
NOTES = {"units": {"u": "deg", "x": "m"}, "run_in": 1.0, "lines": {"ft": [3, 5, 9]}}
TOKENS = (
    *(b"nan", b"inf", b"1e308", b"1e-320", b"-1e160", b"0x1p3", b"1_0", b"", b'"', b'""', b"\n"),
    *(b"\r", b"\r\n", b",", b";", b"\t", b"\0", b"\x1b[2J", b"\xff", b"\xef\xbb\xbf", b"-", b"."),
    *(b"run", b"u_2", b"t,", b"9" * 400, b",,,,", b"[", b"{", b"}", b'"u"', b"\\ud800", b"$$"),
)
LETTERS = b'0123456789.,;-+eE \n"tuxr_{}[]:\x00\x7f'
WORDS = (*range(10), *(14, 15, 16, 17, 0xFF, 0x7FFF, 2**16, 2**31 - 1, 2**31, 2**32 - 1))


@dataclass(frozen=True)
class Sample:
    """A good file, and its sidecar if it has one."""

    suffix: str
    content: bytes
    sidecar: bytes = b""


@dataclass
class Tally:
    """What became of the files of a kind."""

    files: int = 0
    same: int = 0
    explained: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    slowest: float = 0.0
    memory: int = 0


# ------------------------------------------------------------------ good files


def _content(runs: int, forcing: bool) -> dict[str, Any]:
    rng = np.random.default_rng(3)
    content = {
        name: rng.standard_normal((SAMPLES, runs)) for name in SIGNALS[: 5 if forcing else 3]
    }
    return {"t": (np.arange(SAMPLES)[:, np.newaxis] - 20) * DT, **content}


def _csv(runs: int, separator: str = ",", digits: int = 6) -> bytes:
    content = _content(runs, True)
    names = [
        f"{n}_{i + 1}" if runs > 1 and n != "t" else n
        for n in content
        for i in range(content[n].shape[1])
    ]
    rows = np.hstack(list(content.values()))
    body = [separator.join(f"{v:.{digits}g}" for v in row) for row in rows.tolist()]
    return "\n".join([separator.join(names), *body, ""]).encode()


def _long_format() -> bytes:
    lines = _csv(1).decode().splitlines()
    body = [f"{run},{line}" for run in (1, 2) for line in lines[1:]]
    return "\n".join([f"run,{lines[0]}", *body, ""]).encode()


def samples(kind: str) -> list[Sample]:
    """Good files of a kind, in its variants."""
    import json

    if kind == "csv":
        notes = json.dumps(NOTES).encode()
        return [
            Sample(".csv", _csv(1)),
            Sample(".csv", _csv(3), notes),
            Sample(".csv", _csv(1, ";")),
            Sample(".csv", _long_format()),
        ]
    files: list[Sample] = []
    contents = [
        _content(1, False),
        {**_content(2, True), "pilotid": NOTES},
        {"name": "pilot 3", "data": {**_content(1, True), "more": {"a": 1.0}}},
    ]
    for content in contents:
        if kind == "mat":
            from scipy.io import savemat

            content = {**content, "cells": np.array([1.0, "a"], dtype=object)}
            for compression in (False, True):
                stream = io.BytesIO()
                savemat(stream, content, do_compression=compression)
                files.append(Sample(".mat", stream.getvalue()))
        else:
            from matlab_files import save_v73

            for storage in ({}, {"compression": "gzip", "chunks": True}):
                with tempfile.TemporaryDirectory() as folder:
                    path = save_v73(Path(folder) / "F.mat", content, **storage)
                    files.append(Sample(".mat", path.read_bytes()))
    return files


# ------------------------------------------------------------------ changes


def changed(content: bytes, rng: np.random.Generator, text: bool) -> tuple[bytes, int]:
    """The bytes with one to four changes, and how many bytes differ at most."""
    data, touched = bytearray(content), 0
    for _ in range(rng.integers(1, 5)):
        if not data:
            break
        # Headers are small and decide more than numbers do.
        near = rng.random() < 0.6
        first = 512 if data[512:516] == b"\x89HDF" and rng.random() < 0.9 else 0
        at = first + int(
            rng.integers(0, min(len(data) - first, 700 + 3 * first if near else 2**40))
        )
        match rng.integers(0, 9):
            case 0 | 1:
                data[at] = LETTERS[rng.integers(len(LETTERS))] if text else rng.integers(0, 256)
                touched += 1
            case 2:
                data[at] ^= 1 << int(rng.integers(0, 7 if text else 8))
                touched += 1
            case 3 | 4 if text:
                token = TOKENS[rng.integers(len(TOKENS))]
                data[at : at + int(rng.integers(0, 3))] = token
                touched = len(content)
            case 3 | 4:
                at -= at % 4
                word = struct.pack("<I", WORDS[rng.integers(len(WORDS))])
                data[at : at + 4] = word[: len(data) - at]
                touched += 4
            case 5 if not text:
                length = int(rng.integers(1, 40))
                data[at : at + length] = rng.bytes(length)[: len(data) - at]
                touched += length
            case 6 if text or rng.random() < 0.2:
                del data[at : at + int(rng.integers(1, 40))]
                touched = len(content)
            case 7 if text or rng.random() < 0.2:
                other = int(rng.integers(0, len(data)))
                data[at:at] = data[other : other + int(rng.integers(1, 60))]
                touched = len(content)
            case _:
                if rng.random() < 0.2:
                    del data[at:]
                    touched = len(content)
    return bytes(data), touched


def repacked(content: bytes, rng: np.random.Generator) -> tuple[bytes, int]:
    """A compressed MATLAB file with changes inside one of its compressed variables."""
    elements, at = [], 128
    while at < len(content):
        size = struct.unpack("<I", content[at + 4 : at + 8])[0]
        elements.append(content[at + 8 : at + 8 + size])
        at += 8 + size
    chosen, touched = int(rng.integers(len(elements))), 0
    inner, touched = changed(zlib.decompress(elements[chosen]), rng, text=False)
    elements[chosen] = zlib.compress(inner)
    parts = [struct.pack("<II", 15, len(part)) + part for part in elements]
    return content[:128] + b"".join(parts), touched


def mutant(kind: str, number: int, seed: int, good: list[Sample]) -> tuple[int, Sample, int]:
    """The file of a number: which sample it was, what it is, bytes that differ at most."""
    rng = np.random.default_rng([seed, sum(kind.encode()), number])
    index = int(rng.integers(len(good)))
    sample = good[index]
    if sample.sidecar and rng.random() < 0.5:
        sidecar, touched = changed(sample.sidecar, rng, text=True)
        return index, Sample(sample.suffix, sample.content, sidecar), touched
    is_packed = kind == "mat" and sample.content[128:132] == struct.pack("<I", 15)
    if is_packed and rng.random() < 0.8:
        content, touched = repacked(sample.content, rng)
    else:
        content, touched = changed(sample.content, rng, text=kind == "csv")
    return index, Sample(sample.suffix, content, sample.sidecar), touched


# ------------------------------------------------------------------ what explains a recording


def _plain_columns(content: bytes) -> dict[str, list[str]]:
    """The cells of a CSV file by column, read in the simplest way."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    first = text.partition("\n")[0]
    separator = max((",", ";", "\t"), key=first.count)
    rows = list(
        csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
    )
    header = [name.strip() for name in rows[0]]
    body = [row for row in rows[1:] if any(cell.strip() for cell in row)]
    while body and body[0][0].lstrip()[:1] in ("#", "%"):
        del body[0]
    return {name: [row[i].replace(",", ".") for row in body] for i, name in enumerate(header)}


def _explains_csv(loaded: Any, content: bytes) -> bool:
    columns = _plain_columns(content)
    runs = columns.get("run")
    for name in SIGNALS:
        signal = getattr(loaded, name)
        own = [c for c in columns if c == name or re.fullmatch(rf"{name}_\d+", c)]
        own = own or [c for c in columns if re.fullmatch(rf"{name}(_\d+)?", c, re.IGNORECASE)]
        if not own and name in "ex" and loaded.origin[name] != name:
            continue  # it follows from the target, which is looked at, or is not recorded
        if signal is None or not own:
            if (signal is None) == bool(own):
                return False
            continue
        own.sort(key=lambda c: int(c.partition("_")[2] or 0))
        values = np.array([[float(cell) for cell in columns[c]] for c in own])
        if runs:
            labels = [label.strip() for label in runs]
            places = [
                [i for i, r in enumerate(labels) if r == run] for run in dict.fromkeys(labels)
            ]
            values = values[0][np.array(places)]
        if not np.array_equal(np.broadcast_to(values, signal.shape), signal):
            return False
    return True


def explanation(kind: str, loaded: Any, original: Any, content: bytes, touched: int) -> str:
    """Why a recording differs from the original; empty if nothing explains it."""
    if kind == "csv":
        return "the file says so" if _explains_csv(loaded, content) else ""
    differing = 0
    for name in SIGNALS:
        ours, theirs = getattr(loaded, name), getattr(original, name)
        if ours is None or theirs is None or loaded.origin[name] != original.origin[name]:
            continue  # it has another name, and follows from others or is not recorded
        if ours.shape != theirs.shape:
            return ""
        differing += int(np.count_nonzero(np.any(ours != theirs, axis=0)))
    if differing > touched:
        return "numbers are of another kind, or lie elsewhere"
    return "numbers changed" if differing else "names, notes or times changed"


# ------------------------------------------------------------------ reading


def same(one: Any, other: Any) -> bool:
    """Whether two recordings are equal to the bit."""
    for name in SIGNALS:
        a, b = getattr(one, name), getattr(other, name)
        if (a is None) != (b is None) or (a is not None and a.tobytes() != b.tobytes()):
            return False
    names = ("dt", "run_in", "lines", "units", "controlled_element")
    return all(getattr(one, name) == getattr(other, name) for name in names)


def _sentence(message: str, path: Path) -> str:
    """A message without what differs from file to file."""
    message = message.replace(str(path.parent) + "/", "").replace(path.stem, "F")
    message = re.sub(r"'[^']*'|\"[^\"]*\"", "'...'", message.partition(": ")[2])
    message = re.sub(r"-?\d[\d.e+-]*|\b(nan|inf)\b", "N", message)
    message = re.sub(r"(only|columns|the column|column|variable|line N has) .*", r"\1 ...", message)
    return message[:90]


def read_all(pipe: Connection, kind: str, seed: int, first: int, last: int, folder: str) -> None:
    """Read files one after the other and send what became of each."""
    import resource

    from pilotid.recordings.files import load_recording
    from pilotid.support.types import InputError

    good, originals = samples(kind), []
    path = Path(folder) / "F.mat"
    for i, sample in enumerate(good):
        path = Path(folder) / f"good{i}{sample.suffix}"
        path.write_bytes(sample.content)
        if sample.sidecar:
            path.with_suffix(".json").write_bytes(sample.sidecar)
        originals.append(load_recording(path, periods=False))
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    path = Path(folder) / f"mutant{good[0].suffix}"
    for number in range(first, last):
        index, sample, touched = mutant(kind, number, seed, good)
        path.write_bytes(sample.content)
        path.with_suffix(".json").unlink(missing_ok=True)
        if sample.sidecar:
            path.with_suffix(".json").write_bytes(sample.sidecar)
        pipe.send(("start", number))
        start = time.perf_counter()
        try:
            loaded = load_recording(path, periods=False)
        except InputError as error:
            message = str(error)
            bad = "MemoryError" in message or not message.isprintable() or len(message) > 600
            result = ("failure" if bad else "refused", _sentence(message, path))
        except BaseException as error:
            result = ("failure", f"{type(error).__name__}: {error}"[:90])
        else:
            original = originals[index]
            result = ("same", "")
            if not same(loaded, original):
                why = explanation(kind, loaded, original, sample.content, touched)
                result = ("explained", why) if why else ("failure", "not explained")
        seconds = time.perf_counter() - start
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        pipe.send((*result, seconds, memory))
    pipe.send(("end", ""))


def _results(
    kind: str, seed: int, count: int, folder: str
) -> Iterator[tuple[int, tuple[Any, ...]]]:
    """What became of each file, in a new process after each one that ended badly."""
    context = mp.get_context("spawn")
    number = 0
    while number < count:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(
            target=read_all, args=(theirs, kind, seed, number, count, folder), daemon=True
        )
        process.start()
        theirs.close()
        limit = 60.0  # to import and read the good files
        try:
            while ours.poll(limit):
                what, *rest = ours.recv()
                if what == "end":
                    number = count
                    break
                if what == "start":
                    number, limit = rest[0], SECONDS
                    continue
                yield number, (what, *rest)
                number += 1
                limit = 60.0
            else:
                yield number, ("failure", f"no end within {SECONDS:g} s", SECONDS, 0)
                number += 1
        except EOFError:
            process.join()
            yield number, ("failure", f"the process ended with {process.exitcode}", 0.0, 0)
            number += 1
        process.kill()
        process.join()


def tallied(kind: str, seed: int, count: int, keep: Path | None) -> Tally:
    """The tally of a kind of files."""
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder:
        for number, (what, words, seconds, memory) in _results(kind, seed, count, folder):
            tally.files += 1
            tally.slowest = max(tally.slowest, seconds)
            tally.memory = max(tally.memory, memory)
            if what == "same":
                tally.same += 1
            elif what == "failure":
                tally.failures.append(f"file {number}: {words}")
                if keep is not None:
                    _, sample, _ = mutant(kind, number, seed, samples(kind))
                    (keep / f"{kind}{number}{sample.suffix}").write_bytes(sample.content)
                    if sample.sidecar:
                        (keep / f"{kind}{number}.json").write_bytes(sample.sidecar)
            else:
                (tally.explained if what == "explained" else tally.refused)[words] += 1
            if tally.files % 10_000 == 0:
                print(f"{kind}: {tally.files} files", file=sys.stderr)
    return tally


def main() -> int:
    """Print the table; the status is 1 if anything failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--files", type=int, default=100_000, help="files of each kind")
    parser.add_argument("--kinds", default="csv,mat,v73")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sentences", type=int, default=8, help="of refusals to print")
    parser.add_argument("--keep", type=Path, help="folder for the files that failed")
    options = parser.parse_args()
    kinds = options.kinds.split(",")
    tallies = {k: tallied(k, options.seed, options.files, options.keep) for k in kinds}
    columns = ("files", "read, equal", "read, explained", "refused", "failures")
    columns = ("kind", *columns, "slowest [s]", "memory [MB]")
    print(f"| {' | '.join(columns)} |\n{'| --- ' * len(columns)}|")
    for kind, t in tallies.items():
        print(
            f"| {kind} | {t.files} | {t.same} | {t.explained.total()} | {t.refused.total()} | "
            f"{len(t.failures)} | {t.slowest:.2f} | {t.memory / 1024:.0f} |"
        )
    for kind, t in tallies.items():
        print(f"\n{kind}: read, with an explanation")
        for words, number in t.explained.most_common():
            print(f"  {number:7} {words}")
        print(f"{kind}: refused, the commonest of {len(t.refused)} sentences")
        for words, number in t.refused.most_common(options.sentences):
            print(f"  {number:7} {words}")
        for failure in t.failures[:50]:
            print(f"{kind}: FAILURE {failure}")
    return 1 if any(t.failures for t in tallies.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
