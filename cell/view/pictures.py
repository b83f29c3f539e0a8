"""Pictures of a part's surface: number of views that measure it (views.png), causes of uncovered surface (why.png).

The true mesh, drawn by ray casting from directions that show most of the uncovered surface. Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from cell.view import rays
from cell.view.palette import MATERIALS, MEASURED, OPEN, REASONS, SEEN, rgb
from cell.view.surface import Canvas, MeasuredSamples, viewing_directions
from planner.values import Floats, Ints

_PANEL = (500, 480)
_MARGIN, _LINE = 12, 26
_GLYPH_SHARE = 0.16  # of the distance to the part: length of the small pyramid of a view
_MAX_BAR = 0.25  # of the panel's width: length of the scale bar


def draw_part_and_views(
    path: Path,
    canvas: Canvas,
    surface: MeasuredSamples,
    T_object_scanner: Floats,
    opening_deg: tuple[float, float],
    numbers: Sequence[int] | None = None,
    source: str = "",
) -> None:
    """Draw the part coloured by the number of views, from the two sides with most uncovered surface, and the views.

    Args:
        path: PNG to write.
        canvas: the part.
        surface: samples and the views that measure them.
        T_object_scanner: (n, 4, 4) views in visiting order [m].
        opening_deg: of the field of view.
        numbers: (n,) of the views; None counts from 1.
        source: origin of the points; "" for a plan.
    """
    mesh, areas = canvas.mesh, surface.samples.areas
    count = np.minimum(surface.seen.sum(axis=1), len(SEEN))
    colours = np.array([rgb(OPEN), *(rgb(colour) for colour in SEEN)])
    directions = viewing_directions(canvas, count == 0, 2)
    panels = [_draw_panel(canvas, colours[count], toward, mesh.vertices) for toward in directions]
    away = T_object_scanner[:, :3, 3] - (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    far = _GLYPH_SHARE * float(np.median(np.linalg.norm(away, axis=1))) if len(away) else 1.0
    pyramids = rays.pyramid_edges(T_object_scanner, rays.frustum_corners(opening_deg, far))
    around = np.concatenate([mesh.vertices, pyramids.reshape(-1, 3)])
    views, depth = _draw_panel(canvas, colours[count], rays.direction(-60, 25), around)
    rays.draw_lines(views, depth, pyramids, "#333333", hidden="#b9bfc6")
    at = depth.camera.project(T_object_scanner[:, :3, 3])[:, :2]
    middle = np.array(_PANEL) / 2
    outward = (at - middle) / np.maximum(np.linalg.norm(at - middle, axis=1, keepdims=True), 1e-9)
    rays.draw_labels(views, at + 12 * outward, [str(n) for n in numbers or range(1, len(at) + 1)])
    share = np.bincount(count, weights=areas, minlength=len(colours)) / areas.sum()
    names = ["not measured", "1 view", *(str(k) for k in range(2, len(SEEN))), f"{len(SEEN)} or more"]
    legend = [
        (colour, f"{name} ({100 * part:.1f} %)") for colour, name, part in zip(colours, names, share, strict=True)
    ]
    n_views = f"{len(at)} view{'s' * (len(at) != 1)}{', ' * bool(source)}{source}"
    titles = [*map(_direction_name, directions), n_views]
    rays.save_png(_join_panels([*panels, (views, depth)], titles, legend, columns=3), path)


def draw_reasons(path: Path, canvas: Canvas, groups: Sequence[tuple[Ints, str]], title: str) -> None:
    """Draw the part coloured by the causes of uncovered surface, from the sides that show most of it.

    Args:
        path: PNG to write.
        canvas: the part.
        groups: rows of the uncovered samples of each cause, and its name; largest first.
        title: of the picture.
    """
    areas = canvas.samples.areas
    number = group_numbers(len(areas), [rows for rows, _ in groups])
    colours = np.array([rgb(MEASURED), *(rgb(colour) for colour in REASONS)])
    directions = viewing_directions(canvas, number > 0, 4)
    panels = [_draw_panel(canvas, colours[number], toward, canvas.mesh.vertices) for toward in directions]
    share = np.bincount(number, weights=areas, minlength=len(colours)) / areas.sum()
    classes = zip(colours, ["measured", *group_names([name for _, name in groups])], share, strict=False)
    legend = [(colour, f"{name} ({100 * part:.2f} %)") for colour, name, part in classes]
    titles = list(map(_direction_name, directions))
    rays.save_png(_join_panels(panels, titles, legend, columns=2, title=title), path)


def group_names(names: Sequence[str]) -> list[str]:
    """Return names for the numbers of `group_numbers`, from 1."""
    limit = len(REASONS)
    return list(names) if len(names) <= limit else [*names[: limit - 1], f"{len(names) - limit + 1} smaller groups"]


def group_numbers(count: int, groups: Sequence[Ints]) -> NDArray[np.int64]:
    """Return the (count,) group number of each sample from 1, or 0; the last number combines all smaller groups."""
    number = np.zeros(count, dtype=np.int64)
    for code, rows in enumerate(groups, 1):
        number[rows] = min(code, len(REASONS))
    return number


def _draw_panel(canvas: Canvas, colours: Floats, toward: Floats, points: Floats) -> tuple[Image.Image, rays.DepthImage]:
    """Draw the part from one side with colours of its samples (S, 3); the camera is fitted to the (N, 3) `points`."""
    camera, of_face = (
        rays.fit_camera(points, toward, _PANEL, parallel=True),
        np.take(colours, canvas.face_samples, axis=0),
    )
    if canvas.ignored is not None:
        of_face[canvas.ignored] = MATERIALS["surface"]
    return rays.render_mesh(camera, canvas.caster, canvas.normals, of_face)


def _scale_bar(draw: ImageDraw.ImageDraw, left: float, y: float, width: float, mm_per_pixel: float) -> None:
    """Draw a bar of a round length below a panel."""
    limit = _MAX_BAR * width * mm_per_pixel
    base = 10.0 ** np.floor(np.log10(limit))
    length = base * max(k for k in (1, 2, 5) if k * base <= limit)
    end = left + length / mm_per_pixel
    draw.line([(left, y), (end, y)], fill="#111111", width=3)
    draw.text((end + 6, y), f"{length:g} mm", "#111111", rays.font(13), anchor="lm")


def _direction_name(toward: Floats) -> str:
    azimuth, elevation = np.degrees([np.arctan2(toward[1], toward[0]), np.arcsin(np.clip(toward[2], -1, 1))])
    height = f", {abs(elevation):.0f}° {'above' if elevation > 0 else 'below'}" if abs(elevation) > 0.5 else ""
    return f"from azimuth {azimuth:.0f}°{height}"


def _join_panels(
    panels: Sequence[tuple[Image.Image, rays.DepthImage]],
    titles: Sequence[str],
    legend: Sequence[tuple[Floats, str]],
    *,
    columns: int,
    title: str = "",
) -> Image.Image:
    """Join panels with their titles and scale bars in rows, with a legend of coloured squares below."""
    width, height = _PANEL
    rows = -(-len(panels) // columns)
    top, across = _LINE * bool(title), columns * (width + _MARGIN) + _MARGIN
    type_face, small = rays.font(16), rays.font(14)
    places: list[tuple[float, float]] = []
    x, y = float(_MARGIN), top + rows * (height + 2 * _LINE) + _MARGIN / 2
    for _, text in legend:
        needed = 22 + small.getlength(text) + 18
        if x + needed > across and x > _MARGIN:
            x, y = float(_MARGIN), y + _LINE
        places.append((x, y))
        x += needed
    sheet = Image.new("RGB", (across, round(y + _LINE + _MARGIN / 2)), "white")
    draw = ImageDraw.Draw(sheet)
    if title:
        draw.text((across / 2, _LINE / 2 + 4), title, "#111111", rays.font(19), anchor="mm")
    for i, ((panel, depth), name) in enumerate(zip(panels, titles, strict=True)):
        left, upper = _MARGIN + i % columns * (width + _MARGIN), top + i // columns * (height + 2 * _LINE)
        draw.text((left + width / 2, upper + _LINE / 2 + 3), name, "#333333", type_face, anchor="mm")
        sheet.paste(panel, (left, upper + _LINE))
        _scale_bar(draw, left, upper + _LINE + height + 8, width, 2000 * float(depth.camera.half[0]) / width)
    for (colour, text), (x, y) in zip(legend, places, strict=True):
        square = [(x, y + 4), (x + 16, y + 20)]
        draw.rectangle(square, fill=tuple((255 * colour).astype(int).tolist()), outline="#666666")
        draw.text((x + 22, y + 12), text, "#111111", small, anchor="lm")
    return sheet
