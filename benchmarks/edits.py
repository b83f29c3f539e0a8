"""Random edits of plans of every part, and differences of runs, each with an independent check.

Each part is planned at its defaults; edits are drawn (`benchmarks.random_edits`), a quarter of them from a plan that
was edited before. `benchmarks.edit_judge` checks accepted and refused edits. `benchmarks.diff_recount` checks the
differences between an accepted plan and the plan before, between two edited plans, and between executions; a run must
not differ from itself. Pictures and pages are omitted: they take as long as the rest.

SCAN_CELL_EDITS (default 14, the full form has 200) is the number of edits, distributed to the parts in turn; the first
eighth of them, at most 4, also compare executions. With SCAN_CELL_RECHECK=FOLDER plans and finished rows are stored
there, and an interrupted call continues after them.
"""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from pathlib import Path
from time import process_time
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.diff_recount import recounted
from benchmarks.edit_judge import EditJudge
from benchmarks.parts import parts, place
from benchmarks.random_edits import random_edit
from cell.api import edit, open_run, plan, scan
from cell.errors import CellError
from cell.report.diff import compare_runs
from cell.report.plots import PlotProcess
from cell.session import LoggedProgress
from cell.view.run_pages import PARTIAL_PAGE_FILE

_FULL_PAIRS, _EXECUTIONS = 30, 4
_REASONS = {"reach": "out of the arm's reach", "limit": "exceeds a joint limit", "collision": "limits collides"}
_OF_AN_EDITED = 4  # interval of the edits that start from the plan that was edited last


def run() -> list[dict[str, Any]]:
    """Return a row for each part, one over all parts, and one for each finding."""
    count = int(os.environ.get("SCAN_CELL_EDITS", "14"))
    with tempfile.TemporaryDirectory() as scratch, no_pictures():
        folder = Path(os.environ.get("SCAN_CELL_RECHECK", scratch))
        folder.mkdir(parents=True, exist_ok=True)
        rows_file = folder / "rows.jsonl"
        rows = [json.loads(line) for line in rows_file.read_text().splitlines()] if rows_file.exists() else []
        known = list(parts(folder))
        judge = lru_cache(maxsize=None)(
            lambda home: EditJudge(open_run(home / "plan"))
        )  # the cell is that of all edits
        for number in sorted({*range(count)} - {row["edit"] for row in rows}):
            name, arguments = known[number % len(known)]
            home = folder / f"runs {name}"
            _planned(home, arguments)
            rows.append({"part": name, "edit": number} | _judge(home, judge(home), number, count))
            with rows_file.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    rows = sorted((row for row in rows if row["edit"] < count), key=lambda row: row["edit"])
    return [*_summary(rows), *(row for row in rows if row["findings"])]


def _planned(home: Path, arguments: tuple[str, ...]) -> None:
    """Return the plan of a part; it is computed if it does not exist."""
    if not (home / "plan").exists():
        units = {"units": arguments[2]} if len(arguments) > 1 else {}
        shutil.rmtree(home / "plan.part", ignore_errors=True)  # of a call that was stopped
        place_mm = tuple(float(number) for number in place().split(","))
        plan(arguments[0], place=place_mm, out=home / "plan", **units)


def _judge(home: Path, judge: EditJudge, number: int, count: int) -> dict[str, Any]:
    """Make one edit and check its result and its differences."""
    begin = process_time()
    last, out = home / "last", home / f"edit {number}"
    before = open_run(last if number // _OF_AN_EDITED % _OF_AN_EDITED == 3 and last.exists() else home / "plan")
    change = random_edit(np.random.default_rng([number, 17]), before)
    row: dict[str, Any] = {
        "command line": change.command_line,
        "options": json.dumps(change.options),
        "of": before.folder.name,
    }
    for left in (out, out.with_name(f"{out.name}.part")):
        shutil.rmtree(left, ignore_errors=True)  # of a call that was stopped
    try:
        result = edit(before, out=out, **change.options)
    except CellError as error:
        findings = judge.refused(change, error)
        return row | {"refused": str(error), "findings": findings, "s": process_time() - begin}
    findings = [*judge.accepted(before, change, result), *(["should have been refused"] if change.wrong else [])]
    seconds = process_time() - begin
    pairs, samples = 0, 0.0
    if number < _FULL_PAIRS:
        pairs = 1
        sides = [(before.folder, out)]
        if number < min(_EXECUTIONS, count // 8):
            sides.append((_execution(before.folder), _execution(out)))
        for a, b in sides:
            found = compare_runs(a, b, LoggedProgress())
            wrong, samples = recounted(found)
            findings += [f"diff: {each}" for each in wrong]
            findings += [
                f"{each} differs from itself"
                for each in (a, b)
                if not compare_runs(each, each, LoggedProgress()).is_empty
            ]
        pairs = len(sides)
    shutil.rmtree(home / "last", ignore_errors=True)
    out.rename(home / "last")
    return row | {
        "refused": "", "findings": findings, "visible error": judge.visible_error, "pairs": pairs,
        "off samples": samples, "s": seconds,
    }  # fmt: skip


def _execution(run: Path) -> Path:
    """Return the folder of an execution of a run, on a coarse grid of rays."""
    first = run / "executions" / "0001"
    return first if first.exists() else scan(run, resolution=1.0).folder


def _summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each part and one over all parts."""
    names = list(dict.fromkeys(row["part"] for row in rows))
    groups = [(name, [row for row in rows if row["part"] == name]) for name in names]
    return [_counted(name, group) for name, group in [*groups, ("all", rows)]]


def _counted(name: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    accepted = [row for row in rows if not row["refused"]]
    refused = {reason: sum(word in row["refused"] for row in rows) for reason, word in _REASONS.items()}
    return {
        "part": name,
        "edits": len(rows),
        "accepted": len(accepted),
        "repaired": sum("--repair" in row["command line"] for row in accepted),
        "refused": len(rows) - len(accepted),
        **refused,
        "other": len(rows) - len(accepted) - sum(refused.values()),
        "visible error points": 100 * max((abs(row["visible error"]) for row in accepted), default=0.0),
        "diffs": sum(row["pairs"] for row in accepted),
        "off samples": max((row["off samples"] for row in accepted), default=0.0),
        "findings": sum(len(row["findings"]) for row in rows),
        "cpu s an edit": float(np.median([row["s"] for row in rows])) if rows else 0.0,
    }


class _Blank(PlotProcess):
    """Write empty files in place of pictures and of the first half of the page."""

    def __init__(self) -> None:
        self._sent = []

    def _post(self, what: str, path: Path, **arrays: Any) -> None:
        if not path.is_dir():
            path.touch()
            (path.parent / PARTIAL_PAGE_FILE).touch()

    def _wait(self) -> None:
        pass


@contextmanager
def no_pictures() -> Iterator[None]:
    """Make plans without pictures and page, and executions without pictures."""
    with (
        mock.patch("cell.report.plots.plot_process", side_effect=lambda: nullcontext(_Blank())),
        mock.patch("cell.scan.results.draw_part_and_views", lambda path, *_: path.write_bytes(b"")),
        mock.patch("cell.view.run_pages.execution_page", return_value=""),
    ):
        yield
