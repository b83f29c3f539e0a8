"""Pictures by casting rays on triangles: no OpenGL, no display, the same bytes each time.

A camera gives a ray per pixel; what it meets is coloured and shaded by how steep it stands. Lines and numbers are drawn
over the picture, hidden where something is nearer. One frame throughout, metres; pixels count from the top left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cell.errors import FileError
from planner.values import Floats, Ints, Value

_STEPS = 40  # of a line, each of which is hidden or not
_EDGE = 0.15  # of full brightness: neighbours that differ by more are looked at again
_BLOCK = 16_384  # pixels that are drawn at a time
_NEAR = 0.004  # of the camera's distance: what is no farther behind a surface than this counts as on it


@dataclass(frozen=True, slots=True, eq=False)
class Camera(Value):
    """A camera in space.

    Attributes:
        eye: (3,) where it stands [m]; of a parallel camera the middle of its picture.
        forward: (3,) unit, where it looks.
        right: (3,) unit, along a row of pixels.
        half: (2,) half width and height of the picture: tangents, or metres of a parallel camera.
        size: width and height [pixels].
        parallel: whether all rays run along `forward`.
    """

    eye: Annotated[Floats, "3"]
    forward: Annotated[Floats, "3"]
    right: Annotated[Floats, "3"]
    half: Annotated[Floats, "2"]
    size: tuple[int, int]
    parallel: bool

    @property
    def up(self) -> Floats:
        """(3,) unit, from the lower edge of the picture to the upper one."""
        return np.cross(self.right, self.forward)

    def rays(self, pixels: Ints | None = None, off: tuple[float, float] = (0.0, 0.0)) -> tuple[Floats, Floats]:
        """(N, 3) origins and unit directions of pixels.

        Args:
            pixels: (N,) numbers, row by row; None is all of them.
            off: right and down from their middles [pixels].
        """
        columns, rows = self.size
        row, column = np.divmod(np.arange(columns * rows) if pixels is None else pixels, columns)
        x = self.half[0] * (2 * (column + 0.5 + off[0]) / columns - 1)
        y = self.half[1] * (1 - 2 * (row + 0.5 + off[1]) / rows)
        across = x[:, None] * self.right + y[:, None] * self.up
        if self.parallel:
            return self.eye + across, np.broadcast_to(self.forward, across.shape)
        directions = across + self.forward
        directions /= np.sqrt(np.einsum("ij,ij->i", directions, directions))[:, None]
        return np.broadcast_to(self.eye, directions.shape), directions

    def project(self, points: Floats) -> Floats:
        """(N, 3) column, row and distance of (N, 3) points; the distance is the one along the pixel's ray [m]."""
        off = points - self.eye
        depth = off @ self.forward
        scale = 1.0 if self.parallel else np.maximum(depth, 1e-9)
        x, y = (off @ self.right) / scale / self.half[0], (off @ self.up) / scale / self.half[1]
        far = depth if self.parallel else np.linalg.norm(off, axis=1)
        return np.stack([(x + 1) / 2 * self.size[0], (1 - y) / 2 * self.size[1], far], axis=1)


def fitted(
    points: Floats, toward: Floats, size: tuple[int, int], *, parallel: bool, half: float | None = None
) -> Camera:
    """A camera that has all points in its picture.

    Args:
        points: (N, 3) [m].
        toward: (3,) from the points to the camera, of any length but not straight up.
        size: (width, height) [pixels].
        parallel: without perspective.
        half: tangent of half the smaller opening of a camera with perspective; None is 0.3.
    """
    forward = -np.asarray(toward) / np.linalg.norm(toward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    along = points @ np.stack([right, up, forward], axis=1)
    low, high = along.min(axis=0), along.max(axis=0)
    middle, aspect = (low + high) / 2, size[0] / size[1]
    extent = float(max(np.ptp(along, axis=0).max(), 1e-9))
    if parallel:
        tall = 1.03 * max((high[1] - low[1]) / 2, (high[0] - low[0]) / 2 / aspect, extent / 100)
        eye = middle[0] * right + middle[1] * up + (low[2] - extent) * forward
        return Camera(eye, forward, right, np.array([tall * aspect, tall]), size, True)
    tangent = (0.3 if half is None else half) * np.array([aspect, 1.0]) / min(aspect, 1.0)
    for _ in range(5):  # the middle of the picture depends on the distance, a little
        depth = along[:, 2] - middle[2]
        distance = float((np.abs(along[:, :2] - middle[:2]) * 1.06 / tangent - depth[:, None]).max())
        seen = (along[:, :2] - middle[:2]) / (distance + depth)[:, None]
        middle[:2] += distance * (seen.min(axis=0) + seen.max(axis=0)) / 2
    eye = middle[0] * right + middle[1] * up + (middle[2] - distance) * forward
    return Camera(eye, forward, right, tangent, size, False)


def direction(azimuth_deg: float, elevation_deg: float) -> Floats:
    """(3,) unit vector: azimuth from x to y, elevation from the horizontal."""
    a, e = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a camera sees.

    Attributes:
        camera: that looked.
        distance: (P,) along the ray of each pixel, row by row [m]; inf where nothing is met.
    """

    camera: Camera
    distance: Floats


ColourOf = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Colours (N, 3) from 0 to 1 and distances (N,) [m] for origins and directions (N, 3) of rays."""


def render(camera: Camera, colour_of: ColourOf) -> tuple[Image.Image, Seen]:
    """Draw what a camera sees: a ray per pixel, and four where the colour differs from a neighbour's."""
    columns, rows = camera.size
    colour, distance = np.empty((columns * rows, 3)), np.empty(columns * rows)
    for pixels in _blocks(np.arange(columns * rows), _BLOCK):
        colour[pixels], distance[pixels] = colour_of(*camera.rays(pixels))
    for pixels in _blocks(np.flatnonzero(_edges(colour.reshape(rows, columns, 3))), _BLOCK):
        around = [colour_of(*camera.rays(pixels, (x, y)))[0] for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
        colour[pixels] = sum(around) / len(around)
    values = (255 * colour.reshape(rows, columns, 3).clip(0, 1) + 0.5).astype(np.uint8)
    return Image.fromarray(values), Seen(camera, distance)


def _blocks(pixels: Ints, size: int) -> list[Ints]:
    """The same in pieces that stay in the core's cache while they are worked on."""
    return [pixels[start : start + size] for start in range(0, len(pixels), size)]


def _edges(grid: Floats) -> NDArray[np.bool_]:
    """(rows, columns) whether the colour (rows, columns, 3) differs from a neighbour's."""
    edge = np.zeros(grid.shape[:2], dtype=np.bool_)
    for channel in np.moveaxis(grid, 2, 0):
        beside, below = np.abs(np.diff(channel, axis=1)) > _EDGE, np.abs(np.diff(channel, axis=0)) > _EDGE
        edge[:, :-1] |= beside
        edge[:, 1:] |= beside
        edge[:-1] |= below
        edge[1:] |= below
    return edge


def shaded(colour: Floats, facing: Floats) -> Floats:
    """(N, 3) colours, darker where the surface is seen from the side.

    Args:
        colour: (N, 3) from 0 to 1.
        facing: (N,) cosine between normal and the way to the eye; below 0 the surface is seen from behind.
    """
    lit = colour * (0.42 + 0.58 * np.abs(facing))[:, None]
    behind = np.flatnonzero(facing < 0)
    lit[behind] = 0.35 * lit[behind] + 0.25
    return np.asarray(lit)


def lines(
    drawn: Image.Image, seen: Seen, segments: Floats, colour: str, *, width: int = 1, hidden: str | None = None
) -> None:
    """Draw segments over a picture, what is behind a surface in another colour or not at all.

    Args:
        drawn: the picture.
        seen: what the camera saw.
        segments: (N, 2, 3) [m].
        colour: of what is in front.
        width: of a line [pixels].
        hidden: colour of what is behind.
    """
    if not len(segments):
        return
    steps = np.linspace(0, 1, _STEPS + 1)[None, :, None]
    along = segments[:, None, 0] * (1 - steps) + segments[:, None, 1] * steps
    at = seen.camera.project(along.reshape(-1, 3)).reshape(len(segments), -1, 3)
    columns, rows = seen.camera.size
    middle = (at[:, 1:] + at[:, :-1]) / 2
    column = middle[..., 0].astype(np.int64).clip(0, columns - 1)
    row = middle[..., 1].astype(np.int64).clip(0, rows - 1)
    front = middle[..., 2] <= seen.distance[row * columns + column] * (1 + _NEAR)
    draw = ImageDraw.Draw(drawn)
    for i in range(len(segments)):
        for first, last, free in _runs(front[i]):
            if free or hidden:
                ends = [tuple(at[i, first, :2]), tuple(at[i, last, :2])]
                draw.line(ends, fill=colour if free else hidden, width=width)


def frustum(opening_deg: tuple[float, float], far: float) -> Floats:
    """(4, 3) far corners of a field of view [m], scanner frame."""
    x, y = np.tan(np.radians(opening_deg) / 2)
    return far * np.array([[-x, -y, 1.0], [x, -y, 1.0], [x, y, 1.0], [-x, y, 1.0]])


def pyramids(poses: Floats, corners: Floats) -> Floats:
    """(n * 8, 2, 3) edges from the tip and round the base of a pyramid at each of (n, 4, 4) poses [m]."""
    base = np.einsum("nij,kj->nki", poses[:, :3, :3], corners) + poses[:, None, :3, 3]
    tip = np.broadcast_to(poses[:, None, :3, 3], base.shape)
    edges = [np.stack([tip, base], axis=2), np.stack([base, np.roll(base, -1, axis=1)], axis=2)]
    return np.asarray(np.concatenate(edges, axis=1).reshape(-1, 2, 3))


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int, bool]]:
    """Stretches of equal flags: first and last end, flag."""
    cuts = [0, *(np.flatnonzero(flags[1:] != flags[:-1]) + 1).tolist(), len(flags)]
    return [(cuts[k], cuts[k + 1], bool(flags[cuts[k]])) for k in range(len(cuts) - 1)]


def labels(drawn: Image.Image, places: Floats, texts: Sequence[str], size: int = 15) -> None:
    """Write texts at (N, 2) places [pixels], moved as little as needed so that none covers another."""
    draw, type_face, taken = ImageDraw.Draw(drawn), font(size), list[tuple[float, float, float, float]]()
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ways = [(0.0, 0.0), *((r * np.cos(a), r * np.sin(a)) for r in size * np.arange(1, 9) * 0.8 for a in turns)]
    for place, text in zip(places, texts, strict=True):
        left, top, right, bottom = draw.textbbox((0, 0), text, type_face, anchor="mm")
        boxes = [(place[0] + x, place[1] + y) for x, y in ways]
        box = next((at for at in boxes if _free(at, right - left, bottom - top, taken, drawn.size)), boxes[0])
        taken.append((*box, right - left, bottom - top))
        if np.hypot(box[0] - place[0], box[1] - place[1]) > size:
            draw.line([tuple(place), box], fill="#777777")
        draw.text(box, text, "#111111", type_face, anchor="mm", stroke_width=2, stroke_fill="white")


def dots(drawn: Image.Image, places: Floats, colour: str, radius: float = 4.0) -> None:
    """Draw (N, 2) places [pixels] as dots."""
    for x, y in places:
        ImageDraw.Draw(drawn).ellipse((x - radius, y - radius, x + radius, y + radius), colour)


def _free(
    at: tuple[float, float],
    width: float,
    height: float,
    taken: Sequence[tuple[float, float, float, float]],
    size: tuple[int, int],
) -> bool:
    inside = width / 2 < at[0] < size[0] - width / 2 and height / 2 < at[1] < size[1] - height / 2
    return inside and all(
        abs(at[0] - x) > (width + w) / 2 + 2 or abs(at[1] - y) > (height + h) / 2 + 2 for x, y, w, h in taken
    )


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own type face."""
    return ImageFont.load_default(size)


def save(drawn: Image.Image, path: Path) -> None:
    """Write a PNG without anything that changes from run to run.

    Raises:
        FileError: if it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        drawn.save(path, format="png", optimize=False, compress_level=4)
    except OSError as error:
        raise FileError(f"{path} cannot be written: {(error.strerror or str(error)).lower()}") from error
