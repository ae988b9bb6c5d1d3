"""Rows of estimates that the tests of analyses share."""

from __future__ import annotations

from collections.abc import Mapping

from pilotid.analysis.rows import Row


def row(
    subject: str,
    condition: str,
    value: float,
    error: float = 0.1,
    *,
    run: int | None = None,
    model: str = "single",
    parameter: str = "tlead",
    unit: str = "s",
    outcome: str = "converged",
    axis: str = "",
    file: str = "",
) -> Row:
    """A row of a subject in a condition, with a symmetric interval."""
    usable = outcome in ("converged", "at-bound")
    fields = (("subject", subject), ("condition", condition))
    reach = 1.959963984540054 * error
    return Row(
        file or f"subj{subject}_{condition}{axis}.mat",
        fields + ((("axis", axis),) if axis else ()),
        run,
        model,
        "mle",
        parameter,
        unit,
        value if usable else float("nan"),
        error if usable else float("nan"),
        value - reach,
        value + reach,
        outcome,
        usable,
    )


def table(values: Mapping[str, tuple[float, ...]], error: float = 0.1) -> list[Row]:
    """Rows of subjects 1, 2, ... by condition."""
    return [
        row(str(subject), condition, value, error)
        for condition, column in values.items()
        for subject, value in enumerate(column, 1)
    ]
