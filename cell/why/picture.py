"""Where a plan leaves the surface open, in colours: why.ply, all samples; why.png, the part from four sides."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.why.answer import Answer
from planner.surface.mesh import face_normals

_MEASURED = (222, 226, 230)
_COLOURS = (
    (192, 57, 43), (36, 113, 163), (202, 111, 30), (125, 60, 152), (35, 155, 86), (241, 196, 15),
    (23, 165, 137), (127, 140, 141), (100, 30, 22), (21, 67, 96), (183, 149, 11), (74, 35, 90),
)  # fmt: skip
_SIDES = ((0.5, -0.8, 0.4), (-0.5, 0.8, 0.4), (0.7, 0.5, -0.6), (-0.7, -0.5, -0.6))  # looked from where nothing is open
_PICTURED = 0.03  # share of the open samples above which a patch is looked at
_APART = 0.6  # cosine of the angle between two sides that are drawn


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
    colours = np.tile(np.array(_MEASURED, dtype=np.uint8), (len(samples), 1))
    for code, group in enumerate(answer.groups, 1):
        colours[group.rows] = _COLOURS[min(code, len(_COLOURS)) - 1]
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
    """The part from the sides on which most is open, each planning face in the colours of its samples' reasons."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch as Swatch
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    planning = answer.planning
    colours = np.column_stack([np.array([_MEASURED, *_COLOURS]) / 255.0, np.ones(1 + len(_COLOURS))])
    shade, normals = _shade(answer, colours), face_normals(planning)
    triangles = planning.vertices[planning.faces] * 1000.0
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    middle, half = (low + high) / 2, (high - low).max() / 2
    figure = Figure(figsize=(11.0, 10.5), dpi=100, layout="constrained")
    for index, (side, name) in enumerate(_sides(answer)):
        axes: Any = figure.add_subplot(2, 2, index + 1, projection="3d")
        lit = shade.copy()
        lit[:, :3] *= (0.45 + 0.55 * np.clip(normals @ side, 0, 1))[:, None]
        axes.add_collection3d(Poly3DCollection(triangles, facecolors=lit, edgecolors="none", antialiased=False))
        for axis, value in zip("xyz", middle, strict=True):
            getattr(axes, f"set_{axis}lim")(value - half, value + half)
            getattr(axes, f"set_{axis}label")(f"{axis} [mm]", fontsize=8)
            getattr(axes, f"{axis}axis").set_major_locator(MaxNLocator(4))
        axes.tick_params(labelsize=7)
        axes.set_box_aspect((1, 1, 1))
        axes.view_init(elev=np.degrees(np.arcsin(side[2])), azim=np.degrees(np.arctan2(side[1], side[0])))
        axes.set_title(name, fontsize=10)
    measured = 100 * answer.share(np.flatnonzero(answer.covered))
    swatches = [Swatch(color=colours[0], label=f"measured ({measured:.1f} %)")]
    listed = answer.groups[: len(_COLOURS) - 1]
    for code, group in enumerate(listed, 1):
        label = f"{group.title} ({100 * answer.share(group.rows):.2f} %)"
        swatches.append(Swatch(color=colours[code], label=label))
    rest = answer.groups[len(listed) :]
    if rest:
        open_rest = 100 * sum(answer.share(group.rows) for group in rest)
        swatches.append(Swatch(color=colours[-1], label=f"{len(rest)} smaller groups ({open_rest:.2f} %)"))
    figure.legend(handles=swatches, loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    figure.suptitle(f"Why {answer.part_name} stays open", fontsize=12)
    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", metadata={"Software": "scan-cell"})


def _shade(answer: Answer, colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F, 4) colour of each planning face: the mean of its samples', so a face that is half open is half coloured."""
    group_of = np.zeros(len(answer.samples), dtype=np.int64)
    for code, group in enumerate(answer.groups, 1):
        group_of[group.rows] = min(code, len(_COLOURS))
    count = np.zeros((len(answer.planning.faces), len(colours)))
    np.add.at(count, (answer.samples.planning_face, group_of), 1.0)
    count[count.sum(axis=1) == 0, 0] = 1.0
    shade: NDArray[np.float64] = (count / count.sum(axis=1, keepdims=True)) @ colours
    return np.clip(shade, 0, 1)


def _sides(answer: Answer) -> list[tuple[NDArray[np.float64], str]]:
    """Four directions to look from, with their titles: at the largest open patches, as far as these look outward."""
    chosen: list[tuple[NDArray[np.float64], str]] = []
    patches = [
        (patch.rows, group.title)
        for group in answer.groups
        for patch in group.patches
        if len(patch.rows) > _PICTURED * len(answer.open_rows)
    ]
    for rows, name in sorted(patches, key=lambda patch: -len(patch[0])):
        mean = answer.samples.normals[rows].mean(axis=0)
        length = float(np.linalg.norm(mean))
        if len(chosen) < len(_SIDES) and length > 0.3 and all(mean @ side < _APART * length for side, _ in chosen):
            chosen.append((mean / length, f"towards: {name}"))
    for direction in _SIDES:
        side = np.array(direction) / np.linalg.norm(direction)
        if len(chosen) < len(_SIDES) and all(side @ other < _APART for other, _ in chosen):
            chosen.append((side, ""))
    return chosen
