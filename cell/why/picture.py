"""Where a plan leaves the surface open, in colours: why.ply, all samples; why.png, the part from four sides."""

from pathlib import Path

import numpy as np

from cell.runs import ply
from cell.view import pictures
from cell.view.palette import MEASURED, REASONS, rgb
from cell.why.answer import Answer


def points(answer: Answer) -> bytes:
    """The held-out samples as points of a PLY: mm, object frame, coloured by group, with the numbers of why.json.

    Properties: `reason` (a `planner.why.reasons.Reason`, 0 measured), `group` (from 1, 0 measured), `gained` (1 where
    the first change that is named for its group measures the point).
    """
    n = len(answer.samples)
    number = pictures.group_numbers(n, [group.rows for group in answer.groups])
    colours = np.array([(255 * rgb(colour)).round() for colour in (MEASURED, *REASONS)], dtype=np.uint8)[number]
    reason, at, gained = np.zeros(n, np.uint8), np.zeros(n, "<u2"), np.zeros(n, np.uint8)
    for code, group in enumerate(answer.groups, 1):
        at[group.rows], reason[group.rows] = code, group.reason
        if group.named:
            gained[group.rows] = group.named[0].gained[group.rows]
    more = {"red": colours[:, 0], "green": colours[:, 1], "blue": colours[:, 2]}
    more |= {"reason": reason, "group": at, "gained": gained}
    legend = [f"group {code}: {group.title}" for code, group in enumerate(answer.groups, 1)]
    element = ply.point_rows(answer.samples.points, more)
    return b"".join(ply.file_pieces(["object frame, millimetres", *legend], {"vertex": element}))


def draw(path: Path, answer: Answer) -> None:
    """The true part from the sides on which most is open, in the colours of the reasons."""
    groups = [(group.rows, group.title) for group in answer.groups]
    pictures.reasons(path, answer.canvas, groups, f"Why {answer.part_name} stays open")
