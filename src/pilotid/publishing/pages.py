"""Static pages over several studies, which open from a disk without a network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from pilotid.analysis.board import BOARD, read_board
from pilotid.disk import make_folder, strict_json, table_bytes, write_file
from pilotid.publishing import beside, overview
from pilotid.publishing.held import Held, held_in, names_for
from pilotid.report.content import web_page, write_pictures
from pilotid.report.page import write_report
from pilotid.study.store import Store
from pilotid.study.summary import write_tables
from pilotid.types import InputError

TITLE = "Pilot-model identification: studies side by side"
INDEX = "index.html"
#: Names of folders beside those of studies.
TAKEN = (beside.FOLDER,)


def publish(
    folders: Sequence[Path], out: Path, tell: Callable[[str], None] = lambda _: None
) -> Path:
    """Write the pages; equal stores give equal bytes.

    Parameters
    ----------
    folders
        Folders of studies, or of analyses with runs left out; at least one.
    out
        Folder of the pages, which is made.
    tell
        Is told what is damaged.

    Returns
    -------
    Path
        The first page.

    Raises
    ------
    InputError
        If a folder holds no study, or pages would be written over one.
    """
    names = names_for(folders, TAKEN)
    of_people = {
        name: read_board(folder / BOARD)
        for folder, name in zip(folders, names, strict=True)
        if (folder / BOARD).is_file()
    }
    for folder in folders:
        if folder.resolve().parent == out.resolve() or folder.resolve() == out.resolve():
            raise InputError(
                f"{out}: pages there would be written over the study {folder}; name another "
                "folder with --out"
            )
    studies = [
        held_in(folder, name)
        for folder, name in zip(folders, names, strict=True)
        if name not in of_people
    ]
    make_folder(out)
    for held in studies:
        if held.warning:
            tell(held.warning)
        _write_study(held, out / held.name)
    scenarios = beside.scenarios_beside(studies)
    make_folder(out / beside.FOLDER)
    for each in scenarios:
        sections = beside.sections_of(each)
        write_pictures(out / beside.FOLDER, sections)
        page = web_page(f"Scenario {each.entry.name}", sections, f"../{INDEX}")
        write_file(out / beside.FOLDER / f"{each.key}.html", page.encode("utf-8", "replace"))
    rows = overview.score_rows(studies)
    write_file(out / overview.SCORES, table_bytes(overview.SCORE_COLUMNS, rows))
    for name, board in of_people.items():
        make_folder(out / name)
        write_file(out / name / BOARD, strict_json(board.to_dict()).encode())
    sections = [*overview.sections_of(studies, scenarios), *overview.people(of_people)]
    page = web_page(TITLE, sections)
    write_file(out / INDEX, page.encode("utf-8", "replace"))
    return out / INDEX


def _write_study(held: Held, folder: Path) -> None:
    """A study's report with its figures, its tables, and its rows in their small form."""
    make_folder(folder)
    with Store(held.folder) as store:
        store.keep(folder)
        write_tables(folder, held.study)
        write_report(folder, store, held.study, pdf=True, above=f"../{INDEX}")
