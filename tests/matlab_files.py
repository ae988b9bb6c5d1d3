"""MATLAB v7.3 files as MATLAB writes them, for the tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

USERBLOCK = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"


def save_v73(path: Path, content: Mapping[str, Any], **storage: Any) -> Path:
    """Write arrays, texts and structs; `storage` goes to h5py's data sets."""
    with h5py.File(path, "w", userblock_size=512) as file:
        _fill(file, content, storage)
    with path.open("r+b") as stream:
        stream.write(USERBLOCK)
    return path


def _fill(group: Any, content: Mapping[str, Any], storage: Mapping[str, Any]) -> None:
    for name, value in content.items():
        if isinstance(value, dict):
            _fill(group.create_group(name), value, storage)
            group[name].attrs["MATLAB_class"] = np.bytes_("struct")
            continue
        kind = "char" if isinstance(value, str) else np.asarray(value).dtype.name
        if isinstance(value, str):
            value = np.array([[ord(c) for c in value]], dtype=np.uint16)
        array = np.atleast_2d(value).T  # the first index runs fastest in MATLAB
        entry = group.create_dataset(name, data=array, **(storage if array.size > 99 else {}))
        entry.attrs["MATLAB_class"] = np.bytes_({"float64": "double"}.get(kind, kind))
