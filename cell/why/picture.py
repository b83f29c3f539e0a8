"""Where a plan leaves the surface open, in colours: why.ply, all samples; why.png, the part from four sides."""

from pathlib import Path

import numpy as np

from cell.view import pictures
from cell.view.palette import MEASURED, REASONS, rgb
from cell.why.answer import Answer


def ply(answer: Answer) -> bytes:
    """The held-out samples as points: mm, object frame, coloured by group, with the numbers of why.json.

    Properties: `reason` (a `planner.why.reasons.Reason`, 0 measured), `group` (from 1, 0 measured), `gained` (1 where
    the first change that is named for its group measures the point).
    """
    samples = answer.samples
    points = np.zeros(
        len(samples),
        dtype=[
            *((axis, "<f8") for axis in ("x", "y", "z")),
            *((channel, "u1") for channel in ("red", "green", "blue")),
            ("reason", "u1"), ("group", "<u2"), ("gained", "u1"),
        ],
    )  # fmt: skip
    for i, axis in enumerate("xyz"):
        points[axis] = samples.points[:, i] * 1000.0
    number = pictures.group_numbers(len(samples), [group.rows for group in answer.groups])
    colours = np.array([(255 * rgb(colour)).round() for colour in (MEASURED, *REASONS)], dtype=np.uint8)[number]
    for code, group in enumerate(answer.groups, 1):
        points["group"][group.rows] = code
        points["reason"][group.rows] = group.reason
        if group.named:
            points["gained"][group.rows] = group.named[0].gained[group.rows]
    for i, channel in enumerate(("red", "green", "blue")):
        points[channel] = colours[:, i]
    kinds = {"f8": "double", "u1": "uchar", "u2": "ushort"}
    lines = [f"property {kinds[points.dtype[name].str[1:]]} {name}" for name in points.dtype.names or ()]
    legend = [f"comment group {code}: {group.title}" for code, group in enumerate(answer.groups, 1)]
    header = ["ply", "format binary_little_endian 1.0", "comment object frame, millimetres", *legend]
    header += [f"element vertex {len(points)}", *lines, "end_header"]
    return ("\n".join(header) + "\n").encode() + points.tobytes()


def draw(path: Path, answer: Answer) -> None:
    """The true part from the sides on which most is open, in the colours of the reasons."""
    groups = [(group.rows, group.title) for group in answer.groups]
    pictures.reasons(path, answer.canvas, groups, f"Why {answer.part_name} stays open")
