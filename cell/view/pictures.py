"""Pictures of a part's surface: what the views measure (views.png), and why the rest stays open (why.png).

The true mesh, seen by rays from where most of what is not measured shows. Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from cell.view import rays
from cell.view.palette import LOOKS, MEASURED, OPEN, REASONS, SEEN, rgb
from cell.view.surface import Canvas, Surface, sides
from planner.values import Floats, Ints

_PANEL = (500, 480)
_MARGIN, _LINE = 12, 26
_SHARE = 0.16  # of the distance to the part: a view's small pyramid
_BAR = 0.25  # of the panel's width: the scale bar is at most so long


def part_and_views(
    path: Path,
    canvas: Canvas,
    surface: Surface,
    T_object_scanner: Floats,
    opening_deg: tuple[float, float],
    numbers: Sequence[int] | None = None,
    source: str = "",
) -> None:
    """The part coloured by how many views measure it, from the two sides that show most that none does; the views.

    Args:
        path: PNG to write.
        canvas: the part.
        surface: what the views measure of it.
        T_object_scanner: (n, 4, 4) views in visiting order [m].
        opening_deg: of the field of view.
        numbers: (n,) of the views; None counts from 1.
        source: where their points come from; "" of planned ones.
    """
    mesh, areas = canvas.mesh, surface.samples.areas
    count = np.minimum(surface.seen.sum(axis=1), len(SEEN))
    colours = np.array([rgb(OPEN), *(rgb(colour) for colour in SEEN)])
    ways = sides(canvas, count == 0, 2)
    panels = [_panel(canvas, colours[count], way, mesh.vertices) for way in ways]
    away = T_object_scanner[:, :3, 3] - (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    far = _SHARE * float(np.median(np.linalg.norm(away, axis=1))) if len(away) else 1.0
    pyramids = rays.pyramids(T_object_scanner, rays.frustum(opening_deg, far))
    around = np.concatenate([mesh.vertices, pyramids.reshape(-1, 3)])
    views, seen = _panel(canvas, colours[count], rays.direction(-60, 25), around)
    rays.lines(views, seen, pyramids, "#333333", hidden="#b9bfc6")
    at = seen.camera.project(T_object_scanner[:, :3, 3])[:, :2]
    middle = np.array(_PANEL) / 2
    outward = (at - middle) / np.maximum(np.linalg.norm(at - middle, axis=1, keepdims=True), 1e-9)
    rays.labels(views, at + 12 * outward, [str(n) for n in numbers or range(1, len(at) + 1)])
    share = np.bincount(count, weights=areas, minlength=len(colours)) / areas.sum()
    names = ["not measured", "1 view", *(str(k) for k in range(2, len(SEEN))), f"{len(SEEN)} or more"]
    legend = [
        (colour, f"{name} ({100 * part:.1f} %)") for colour, name, part in zip(colours, names, share, strict=True)
    ]
    titles = [*(_from(way) for way in ways), f"{len(at)} view{'s' * (len(at) != 1)}{', ' * bool(source)}{source}"]
    rays.save(_sheet([_scaled(panel) for panel in [*panels, (views, seen)]], titles, legend, columns=3), path)


def reasons(path: Path, canvas: Canvas, groups: Sequence[tuple[Ints, str]], title: str) -> None:
    """The part from the sides that show most of what is open, coloured by reasons.

    Args:
        path: PNG to write.
        canvas: the part.
        groups: rows of the samples that stay open for a reason, and its name; largest first.
        title: of the picture.
    """
    areas = canvas.samples.areas
    number = group_numbers(len(areas), [rows for rows, _ in groups])
    colours = np.array([rgb(MEASURED), *(rgb(colour) for colour in REASONS)])
    ways = sides(canvas, number > 0, 4)
    panels = [_panel(canvas, colours[number], way, canvas.mesh.vertices) for way in ways]
    share = np.bincount(number, weights=areas, minlength=len(colours)) / areas.sum()
    named = zip(colours, ["measured", *group_names([name for _, name in groups])], share, strict=False)
    legend = [(colour, f"{name} ({100 * part:.2f} %)") for colour, name, part in named]
    titles = [_from(way) for way in ways]
    rays.save(_sheet([_scaled(panel) for panel in panels], titles, legend, columns=2, title=title), path)


def group_names(names: Sequence[str]) -> list[str]:
    """Names for the numbers of `group_numbers`, from 1."""
    most = len(REASONS)
    return list(names) if len(names) <= most else [*names[: most - 1], f"{len(names) - most + 1} smaller groups"]


def group_numbers(count: int, groups: Sequence[Ints]) -> NDArray[np.int64]:
    """(count,) number of the group of each sample from 1, 0: none; the last number stands for all smaller groups."""
    number = np.zeros(count, dtype=np.int64)
    for code, rows in enumerate(groups, 1):
        number[rows] = min(code, len(REASONS))
    return number


def _panel(canvas: Canvas, colours: Floats, toward: Floats, shown: Floats) -> tuple[Image.Image, rays.Seen]:
    """The part from one side in its samples' colours (S, 3); `shown` (N, 3) are in the picture."""
    camera = rays.fitted(shown, toward, _PANEL, parallel=True)
    facing, of_face = canvas.normals @ -camera.forward, np.take(colours, canvas.own, axis=0)
    if canvas.aside is not None:
        of_face[canvas.aside] = LOOKS["surface"]

    def colour_of(origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        hits = canvas.caster.first_hit(origins, directions)
        picture, hit = np.ones((len(origins), 3)), np.flatnonzero(hits.face >= 0)
        face = hits.face[hit]
        picture[hit] = rays.shaded(np.take(of_face, face, axis=0), facing[face])
        return picture, hits.distance

    return rays.render(camera, colour_of)


def _scale_bar(draw: ImageDraw.ImageDraw, left: float, y: float, width: float, mm_per_pixel: float) -> None:
    """A round length under a panel."""
    most = _BAR * width * mm_per_pixel
    base = 10.0 ** np.floor(np.log10(most))
    length = base * max(k for k in (1, 2, 5) if k * base <= most)
    end = left + length / mm_per_pixel
    draw.line([(left, y), (end, y)], fill="#111111", width=3)
    draw.text((end + 6, y), f"{length:g} mm", "#111111", rays.font(13), anchor="lm")


def _scaled(panel: tuple[Image.Image, rays.Seen]) -> tuple[Image.Image, float]:
    """A panel with its scale [mm per pixel]."""
    return panel[0], 2000 * float(panel[1].camera.half[0]) / _PANEL[0]


def _from(way: Floats) -> str:
    """Where a picture is seen from, in words."""
    azimuth, elevation = np.degrees(np.arctan2(way[1], way[0])), np.degrees(np.arcsin(np.clip(way[2], -1, 1)))
    height = f", {abs(elevation):.0f}° {'above' if elevation > 0 else 'below'}" if abs(elevation) > 0.5 else ""
    return f"from azimuth {azimuth:.0f}°{height}"


def _sheet(
    panels: Sequence[tuple[Image.Image, float]],
    titles: Sequence[str],
    legend: Sequence[tuple[Floats, str]],
    *,
    columns: int,
    title: str = "",
) -> Image.Image:
    """Panels with their scales [mm per pixel] in rows with their titles, and a legend of coloured squares below."""
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
    for i, ((panel, mm_per_pixel), name) in enumerate(zip(panels, titles, strict=True)):
        left, upper = _MARGIN + i % columns * (width + _MARGIN), top + i // columns * (height + 2 * _LINE)
        draw.text((left + width / 2, upper + _LINE / 2 + 3), name, "#333333", type_face, anchor="mm")
        sheet.paste(panel, (left, upper + _LINE))
        _scale_bar(draw, left, upper + _LINE + height + 8, width, mm_per_pixel)
    for (colour, text), (x, y) in zip(legend, places, strict=True):
        square = [(x, y + 4), (x + 16, y + 20)]
        draw.rectangle(square, fill=tuple((255 * colour).astype(int).tolist()), outline="#666666")
        draw.text((x + 22, y + 12), text, "#111111", small, anchor="lm")
    return sheet
