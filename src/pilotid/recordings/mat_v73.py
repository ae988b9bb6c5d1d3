"""Variables of MATLAB v7.3 files: HDF5 within the limits of v5, and nothing outside the file.

By h5py, the extra `matlab`.  HDF5 can point to other files (links, external storage, virtual data
sets), and gives zeros for what is missing; a recording that MATLAB wrote does neither.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pilotid.recordings.mat_variables import (
    DEEPEST,
    LONGEST_TEXT,
    MOST_ARRAYS,
    Chosen,
    DamagedError,
    Value,
    Variables,
)
from pilotid.recordings.names import MOST_VALUES
from pilotid.types import InputError

DEFLATE, SHUFFLE = 1, 2  # filters that MATLAB may use; others may load foreign code
MOST_CHUNKS = 2**16
Array = NDArray[np.generic]
LONGEST_CLASS = 100  # bytes


class MatV73(Variables):
    """A MATLAB v7.3 file.

    Parameters
    ----------
    path
        The file.
    source
        Its name in messages.

    Raises
    ------
    InputError
        If h5py is not installed; when anything is read, if the file is damaged, exceeds a limit
        or points outside itself.
    """

    def __init__(self, path: Path, source: str) -> None:
        try:
            import h5py
        except ImportError:
            raise InputError(
                f"{source}: is a MATLAB v7.3 file; save it with save -v7, or install "
                "pilotid[matlab]"
            ) from None
        super().__init__(path, source)
        self._h5py: Any = h5py

    def walked(self, wanted: Chosen, entered: Chosen) -> Iterator[tuple[str, Value]]:
        try:
            with self._h5py.File(self._path, "r") as file:
                yield from self._group(file, "", wanted, entered)
        except InputError:
            raise
        except Exception as error:  # HDF5 fails on damage in any way whatsoever
            what = error if isinstance(error, DamagedError) else type(error).__name__
            raise InputError(
                f"{self._source}: the MATLAB file is damaged or cut short ({what}); save it again "
                "with save -v7"
            ) from None

    def _group(
        self, group: Any, prefix: str, wanted: Chosen, entered: Chosen
    ) -> Iterator[tuple[str, Value]]:
        h5py = self._h5py
        if prefix.count(".") > DEEPEST:
            raise DamagedError(f"structs are more than {DEEPEST} deep")
        for key in group.id:  # bytes: names need not be UTF-8
            self._budget.look()
            name = prefix + key.decode("utf-8", "backslashreplace")
            if not prefix and name.startswith("#"):
                continue  # what cells and objects refer to
            if group.id.links.get_info(key).type != h5py.h5l.TYPE_HARD:
                if wanted(name):
                    raise DamagedError(f"variable {name} is a link to another place")
                yield name, None
                continue
            yield from self._entry(group[key], name, wanted, entered)

    def _entry(
        self, entry: Any, name: str, wanted: Chosen, entered: Chosen
    ) -> Iterator[tuple[str, Value]]:
        h5py = self._h5py
        if isinstance(entry, h5py.Group) and "MATLAB_sparse" not in entry.attrs:
            if entered(name):
                yield from self._group(entry, f"{name}.", wanted, entered)
        elif isinstance(entry, h5py.Dataset) and self._refers(entry):
            if entered(name) or entered(_member(name, 1, cell=False)):
                yield from self._members(entry, name, wanted, entered)
        elif isinstance(entry, h5py.Dataset) and "MATLAB_object_decode" in entry.attrs:
            self.objects[name] = self._class(entry).decode("utf-8", "backslashreplace")
            yield name, None
        elif isinstance(entry, h5py.Dataset) and wanted(name):
            yield name, self._value(name, entry)
        else:
            yield name, None

    def _refers(self, entry: Any) -> bool:
        """Whether a data set holds places of others: a cell array, or a field of many structs."""
        h5py = self._h5py
        if entry.dtype.kind != "O" or h5py.check_ref_dtype(entry.dtype) is not h5py.Reference:
            return False
        return self._class(entry) in (b"cell", b"")

    def _members(
        self, entry: Any, name: str, wanted: Chosen, entered: Chosen
    ) -> Iterator[tuple[str, Value]]:
        h5py = self._h5py
        if name.count(".") + name.count("{") > DEEPEST:
            raise DamagedError(f"structs are more than {DEEPEST} deep")
        if entry.size > MOST_ARRAYS:
            raise DamagedError(f"more than {MOST_ARRAYS} variables")
        cell = self._class(entry) == b"cell"
        plist = entry.id.get_create_plist()
        if entry.is_virtual or plist.get_external_count() or plist.get_nfilters():
            raise DamagedError(f"variable {name} is stored in an unusual way")
        for number, reference in enumerate(entry[()].T.ravel(order="F"), start=1):
            self._budget.look()
            own = _member(name, number, cell=cell)
            if not (entered(own) or wanted(own)):
                yield own, None
                continue
            if h5py.h5r.get_obj_type(reference, entry.id) not in (
                h5py.h5o.TYPE_GROUP,
                h5py.h5o.TYPE_DATASET,
            ):
                raise DamagedError(f"variable {own} is missing")
            yield from self._entry(entry.file[reference], own, wanted, entered)

    def _value(self, name: str, entry: Any) -> Value:
        kind = self._class(entry)
        is_text = kind == b"char"
        if "MATLAB_empty" in entry.attrs:
            return "" if is_text else np.zeros(0)
        if entry.dtype.kind not in "fiub" or kind in (b"cell", b"function_handle"):
            return None
        self._check_storage(name, entry)
        self._budget.read(entry.size)
        if is_text and entry.size > LONGEST_TEXT:
            raise DamagedError(f"a text of {entry.size} characters")
        values: Array = (self._unpacked(name, entry) if entry.chunks else entry[()]).T
        if is_text:
            codes = values.astype("<u2").tobytes()
            return codes.decode("utf-16-le") if values.shape[0] == 1 else None
        return values.squeeze()

    def _class(self, entry: Any) -> bytes:
        """What MATLAB calls the kind of a variable."""
        if "MATLAB_class" not in entry.attrs:
            return b""
        if entry.attrs.get_id("MATLAB_class").get_storage_size() > LONGEST_CLASS:
            raise DamagedError("the kind of a variable is no word")
        kind = entry.attrs["MATLAB_class"]
        return kind.encode() if isinstance(kind, str) else bytes(kind)

    def _check_storage(self, name: str, entry: Any) -> None:
        """Refuse data that are elsewhere, missing, or stored in a way that MATLAB does not."""
        identifier = entry.id
        if entry.is_virtual or identifier.get_create_plist().get_external_count():
            raise DamagedError(f"variable {name} is stored in another file")
        if not self._h5py.h5t.py_create(entry.dtype).equal(identifier.get_type()):
            raise DamagedError(f"variable {name} holds numbers of an unknown kind")
        size = entry.size * entry.dtype.itemsize
        if not entry.size or size > 8 * MOST_VALUES:
            raise DamagedError(f"variable {name} claims {entry.size} values")
        if not entry.chunks and identifier.get_storage_size() != size:
            raise DamagedError(f"parts of variable {name} are missing")

    def _unpacked(self, name: str, entry: Any) -> Array:
        """A variable in chunks, unpacked here: HDF5 would follow a chunk to any size."""
        plist = entry.id.get_create_plist()
        filters = [plist.get_filter(i)[0] for i in range(plist.get_nfilters())]
        shape, chunks, dtype = entry.shape, entry.chunks, entry.dtype
        count = math.prod(-(-n // m) for n, m in zip(shape, chunks, strict=True))
        size = math.prod(chunks) * dtype.itemsize
        usual = filters in ([], [DEFLATE], [SHUFFLE, DEFLATE])
        if not usual or count > MOST_CHUNKS or size > 8 * MOST_VALUES:
            raise DamagedError(f"variable {name} is packed in an unusual way")
        found: dict[tuple[int, ...], int] = {}

        def look(chunk: Any) -> None:
            at = tuple(chunk.chunk_offset)
            if chunk.filter_mask == 0 and all(i < n for i, n in zip(at, shape, strict=True)):
                found[at] = chunk.size

        entry.id.chunk_iter(look)
        if len(found) != count:
            raise DamagedError(f"parts of variable {name} are missing")
        values = np.empty(shape, dtype)
        for at, stored in found.items():
            if stored > 2 * size + 1000:
                raise DamagedError(f"a part of variable {name} is larger than the whole")
            content = entry.id.read_direct_chunk(at)[1]
            if DEFLATE in filters:
                content = _inflated(content, size)
            if len(content) != size:
                raise DamagedError(f"a part of variable {name} has another size than it says")
            if SHUFFLE in filters:  # the first bytes of all numbers, then the second ones, ...
                content = np.frombuffer(content, "u1").reshape(dtype.itemsize, -1).T.tobytes()
            block = np.frombuffer(content, dtype).reshape(chunks)
            place = tuple(
                slice(i, min(i + m, n)) for i, m, n in zip(at, chunks, shape, strict=True)
            )
            values[place] = block[tuple(slice(0, p.stop - p.start) for p in place)]
        return values


def _member(name: str, number: int, *, cell: bool) -> str:
    """The name of a cell, or of a field (the last part of the name) in one struct of many."""
    if cell:
        return f"{name}{{{number}}}"
    struct, _, field = name.rpartition(".")
    return f"{struct}({number}).{field}"


def _inflated(packed: bytes, size: int) -> bytes:
    """What was packed, or a byte more than its size if it is larger; none if it is damaged."""
    inflate = zlib.decompressobj()
    try:
        content = inflate.decompress(packed, size)
        content += inflate.decompress(inflate.unconsumed_tail, 1)
    except zlib.error:
        return b""
    return content if inflate.eof else b""
