"""What is said of a recording beside its file, in F.json."""

from __future__ import annotations

import codecs
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from pilotid.recording.recording import SIGNALS
from pilotid.recording.windows import sidecar_path
from pilotid.support.disk import path_shown, require_file
from pilotid.support.types import InputError

Count = Annotated[int, Field(ge=1, lt=10**15)]
#: What can label an axis: printable, no dollar sign.
LABEL = r"^[^$\p{C}\p{Zl}\p{Zp}]*$"


class Sidecar(BaseModel):
    """The facts; what is not said is None or empty.

    Attributes
    ----------
    runs, run_in, dt
        Number of runs, length of the run-in [s], sampling interval [s].
    units, lines, controlled_element
        As in `Recording`.
    extra
        Names of extra signals that the file holds by these names.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    runs: Count | None = None
    run_in: Annotated[float, Field(ge=0, lt=1e9)] | None = None
    dt: Annotated[float, Field(ge=1e-6, le=100)] | None = None
    units: dict[str, Annotated[str, Field(max_length=40, pattern=LABEL)]] = {}
    lines: dict[Literal["ft", "fd"], list[Count]] = {}
    extra: list[str] = []
    controlled_element: Annotated[str, Field(max_length=200, pattern=LABEL)] = ""

    @model_validator(mode="after")
    def _units_of_signals(self) -> Self:
        if unknown := self.units.keys() - {*SIGNALS, *self.extra}:
            raise ValueError(f"units: {min(unknown)[:50]!r} is no signal, nor named under extra")
        return self


def parsed(raw: str | bytes, where: str) -> Sidecar:
    """The facts in JSON text.

    Parameters
    ----------
    raw
        The text.
    where
        Where it stands, for messages.

    Raises
    ------
    InputError
        For an unknown key or a value of the wrong kind; of broken JSON with the line.
    """
    try:
        return Sidecar.model_validate_json(raw)
    except ValidationError as error:
        wrong = error.errors()[0]
        place = ".".join(map(str, wrong["loc"])) or "all of it"
        what = wrong["msg"].removeprefix("Value error, ")
        raise InputError(
            f"{where}: {place[:50]}: {what}; correct it, leave it out or rename the file "
            f"(the keys are {', '.join(Sidecar.model_fields)})"
        ) from None


def read_sidecar(file: Path) -> Sidecar:
    """The facts beside a file; none where it has no sidecar.

    Raises
    ------
    InputError
        If the sidecar cannot be used.
    """
    path = sidecar_path(file)
    if not path.is_file():
        return Sidecar()
    require_file(path)
    return parsed(path.read_bytes().removeprefix(codecs.BOM_UTF8), path_shown(path))
