"""The table of runs left out: methods and models ranked on recordings of people."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pilotid.analysis.analyse import Group, group_of
from pilotid.analysis.board import Board
from pilotid.analysis.cross_validation import LeftOut, Standing, rank_methods
from pilotid.analysis.report_estimates import group_words
from pilotid.numbers import NONE, number, plus_minus
from pilotid.report.content import Block, Column, Entry, Table, Text

TEXT = (
    "No truth is known of people: what judges here is the run that a fit has not seen. Every run "
    "is predicted by the fit of the other runs of its recording. **VAF**: of its control, as "
    "the simulated response explains it. **Likelihood**: of its whitened prediction errors (nats a "
    "run), less that of the best of the same recordings, run by run; the remnant's model is chosen "
    "the same way for all, from what each leaves of the other runs. It is of all the control: the "
    "inverse of the controlled element predicts that well and is no pilot, which the VAF shows. "
    "**Runs / claims** is the agreement between runs: how many times as much as claimed the "
    "estimates of single runs differ, the median over parameters and recordings (--per-run). "
    "After ± stands the standard error over the runs; runs of one subject are alike, so that it "
    "is too small for other subjects."
)


def left_out_blocks(board: Board) -> list[Block]:
    """What runs left out are, and models and methods by them, within each kind of recording."""
    columns = [
        Column("recordings", text=True),
        Column("model", text=True),
        Column("method", text=True),
        Column("runs", hint="left out of a fit"),
        Column("failed", hint="fits of the others that do not count"),
        Column("VAF %", hint="of the runs left out"),
        Column("likelihood", hint="log-likelihood of a run left out, less that of the best"),
        Column("runs / claims", hint="scatter of single runs over their claimed errors"),
    ]
    groups: dict[Group, list[LeftOut]] = {}
    for each in board.lines:
        groups.setdefault(group_of(each.part), []).append(each)
    rows = [
        _row(board, group, own, standing)
        for group, own in groups.items()
        for standing in rank_methods(own)
    ]
    caption = "Runs predicted by the fit of the others, the likeliest first"
    filters = (0, 1, 2) if len(rows) > 12 else ()
    return [Text(TEXT), Table(caption, columns, rows, heads=2, filters=filters)]


def _row(board: Board, group: Group, own: Sequence[LeftOut], s: Standing) -> Sequence[Entry]:
    best = s.behind == 0.0 and not math.isfinite(s.behind_error)
    files = {each.part.name for each in own}
    ratios = [
        ratio
        for (file, model, method), found in board.ratios.items()
        if file in files and (model, method) == (s.model, s.method)
        for ratio in found
        if math.isfinite(ratio)
    ]
    return [
        Entry(group_words(group)),
        Entry(s.model),
        Entry(s.method),
        Entry(str(s.runs)),
        Entry(str(s.failed)),
        Entry(plus_minus(s.vaf, s.vaf_error).lstrip("+")),
        Entry("best" if best else plus_minus(s.behind, s.behind_error), "good" if best else ""),
        Entry(number(float(np.median(ratios)), 2) if ratios else NONE),
    ]
