"""What `cell why` writes and prints: why.json, why.ply, why.png and view.html in `why/` of the run, and the table.

The plan's own files stay as they are; an older `why/` is replaced.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cell.errors import FileError
from cell.runs.folder import SCHEMA, json_text
from cell.runs.run import Run
from cell.runs.schema import NamedChange, OpenPatch, OpenSamples, TriedChange, WhyReport
from cell.view import contents
from cell.why import picture
from cell.why.answer import Answer, Group, Named, Patch
from planner.values import Ints

FOLDER = "why"
NOTHING = "nothing that was tried helps"
_CHANGES = 2  # named in a row of the table
_ROWS = 12  # of the table; the rest is one line, and in why.json


def report_of(answer: Answer, run: Run) -> WhyReport:
    """The content of why.json."""
    return WhyReport(
        part=answer.part_name,
        plan=run.plan_sha256,
        samples=len(answer.samples),
        area_mm2=round(float(answer.samples.areas.sum()) * 1e6, 3),
        visible=answer.share(np.flatnonzero(answer.covered)),
        open=answer.share(answer.open_rows),
        groups=tuple(_group(answer, code, group) for code, group in enumerate(answer.groups, 1)),
        not_measurable=answer.share(answer.rest),
        overall=tuple(_named(answer, named, answer.rest) for named in answer.overall),
        tried=tuple(
            TriedChange(
                kind=change.kind.name.lower(),
                change=change.sentence,
                setting=change.setting,
                gains_estimated=round(share, 4),
            )
            for change, share in answer.tried
        ),
    )


def write(run: Run, answer: Answer, report: WhyReport) -> Path:
    """Write the files; returns their folder.

    Raises:
        FileError: if the run folder cannot be written.
    """
    target, part = run.folder / FOLDER, run.folder / (FOLDER + ".part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir()
        (part / "why.json").write_text(json_text({"schema": SCHEMA, **report.as_json()}), encoding="utf-8")
        (part / "why.ply").write_bytes(picture.points(answer))
        picture.draw(part / "why.png", answer)
        reasons = [(group.rows, group.title) for group in answer.groups]
        (part / contents.NAME).write_text(
            contents.why_page(run, answer.canvas, answer.surface, reasons), encoding="utf-8"
        )
        shutil.rmtree(target, ignore_errors=True)
        part.rename(target)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FileError(f"{target} cannot be written: {reason}; the run folder must be writable") from error
    return target


TABLE_COLUMNS = ("reason", "of the surface", "where (mm, part)", "what would measure it")


def table_rows(report: WhyReport) -> list[tuple[str, str, str, str]]:
    """Rows of the table: reason, share and area, where, what would measure it."""
    rows = []
    for group in report.groups[:_ROWS]:
        reason = group.title + (f"\n({group.detail})" if group.detail else "")
        x, y, z = (round(value) for value in group.patches[0].centre_mm)
        where = f"near ({x}, {y}, {z})" + (f"\n{group.n_patches} places" * (group.n_patches > 1))
        rows.append((reason, _area(group.share, group.area_mm2), where, _lines(group.changes[:_CHANGES])))
    rest = report.groups[_ROWS:]
    if rest:
        share, area = sum(group.share for group in rest), sum(group.area_mm2 for group in rest)
        rows.append((f"{len(rest)} smaller groups", _area(share, area), "", "see why.json"))
    if report.not_measurable and len(report.groups) > 1:
        area = report.not_measurable * report.area_mm2
        helps = _lines(report.overall)
        rows.append(("all that no reachable candidate measures", _area(report.not_measurable, area), "", helps))
    return rows


def _area(share: float, area_mm2: float) -> str:
    return f"{100 * share:.2f} %\n{area_mm2:,.0f} mm²"


def _lines(changes: Sequence[NamedChange]) -> str:
    """What would measure it, a line each."""
    lines = (f"{_percent(c.gains)}: {c.change}" + (f" ({c.setting})" if c.setting else "") for c in changes)
    return "\n".join(lines) or NOTHING


def _percent(share: float) -> str:
    if share >= 1:
        return "all"
    if share >= 0.995:  # never rounded up to all
        return f"{np.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.0f} %" if share >= 0.095 else f"{100 * share:.1f} %"


def _group(answer: Answer, code: int, group: Group) -> OpenSamples:
    return OpenSamples(
        group=code,
        reason=group.reason.name.lower(),
        code=int(group.reason),
        what=group.what,
        title=group.title,
        detail=group.detail,
        share=answer.share(group.rows),
        area_mm2=_area_mm2(answer, group.rows),
        n_patches=len(group.patches),
        changes=tuple(_named(answer, named, group.rows) for named in group.named),
        patches=tuple(_patch(answer, patch) for patch in group.patches[:20]),
    )


def _patch(answer: Answer, patch: Patch) -> OpenPatch:
    points = answer.samples.points[patch.rows] * 1000
    nearest = np.linalg.norm(points - answer.samples.points[patch.rows].mean(axis=0) * 1000, axis=1).argmin()
    return OpenPatch(
        area_mm2=_area_mm2(answer, patch.rows),
        centre_mm=tuple(points[nearest].round(2).tolist()),
        change=None if patch.named is None else _named(answer, patch.named, patch.rows),
    )


def _named(answer: Answer, named: Named, rows: Ints) -> NamedChange:
    """A change with the share of some rows that it measures, all of them asked."""
    areas = answer.samples.areas[rows]
    return NamedChange(
        kind=named.change.kind.name.lower(),
        change=named.change.sentence,
        setting=named.change.setting,
        gains=float(areas[named.gained[rows]].sum() / areas.sum()),
        gains_mm2=_area_mm2(answer, rows[named.gained[rows]]),
    )


def _area_mm2(answer: Answer, rows: Ints) -> float:
    return round(float(answer.samples.areas[rows].sum()) * 1e6, 3)
