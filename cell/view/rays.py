"""Pictures by ray casting on triangles: no OpenGL, no display, reproducible bytes.

A camera casts a ray per pixel. The hit surface gives the colour, shaded by its angle to the ray. Lines and labels are
drawn over the picture; a depth test hides lines behind a surface. One frame throughout, metres; pixels count from the
top left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cell.files import atomic_write, file_errors
from planner.ports import RayCaster
from planner.values import Floats, Ints, Value

GLYPH_SHARE = 0.16
"""Length of the small pyramid of a view, as a share of the frustum's length."""

_STEPS = 40  # pieces of a line, each hidden or visible
_EDGE_CONTRAST = 0.15  # of full brightness: pixels that differ more from a neighbour get four rays
_BLOCK = 16_384  # pixels drawn at a time
_DEPTH_TOLERANCE = 0.004  # of the distance: a point this little behind a surface counts as on it


@dataclass(frozen=True, slots=True, eq=False)
class Camera(Value):
    """A camera with central or parallel projection.

    Attributes:
        eye: position [m]; for a parallel camera the middle of its picture.
        forward: unit vector of the viewing direction.
        right: unit vector along a row of pixels.
        half: half width and height of the picture: tangents, or metres for a parallel camera.
        size: width and height [pixels].
        parallel: whether all rays have the direction `forward`.
    """

    eye: Annotated[Floats, "3"]
    forward: Annotated[Floats, "3"]
    right: Annotated[Floats, "3"]
    half: Annotated[Floats, "2"]
    size: tuple[int, int]
    parallel: bool

    @property
    def up(self) -> Floats:
        """(3,) unit vector from the lower edge of the picture to the upper one."""
        return np.cross(self.right, self.forward)

    def rays(self, pixels: Ints | None = None, off: tuple[float, float] = (0.0, 0.0)) -> tuple[Floats, Floats]:
        """Return (N, 3) origins and unit directions of the rays of pixels.

        Args:
            pixels: (N,) numbers, row by row; None for all.
            off: offset to the right and down from the pixels' centres [pixels].
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
        """Return (N, 3) column, row and distance along the pixel's ray [m] of (N, 3) points."""
        off = points - self.eye
        depth = off @ self.forward
        scale = 1.0 if self.parallel else np.maximum(depth, 1e-9)
        x, y = (off @ self.right) / scale / self.half[0], (off @ self.up) / scale / self.half[1]
        far = depth if self.parallel else np.linalg.norm(off, axis=1)
        return np.stack([(x + 1) / 2 * self.size[0], (1 - y) / 2 * self.size[1], far], axis=1)


def fit_camera(
    points: Floats, toward: Floats, size: tuple[int, int], *, parallel: bool, half: float | None = None
) -> Camera:
    """Return a camera whose picture contains all points.

    Args:
        points: (N, 3) [m].
        toward: (3,) from the points to the camera, of any length.
        size: (width, height) [pixels].
        parallel: without perspective.
        half: tangent of half the smaller opening of a camera with perspective; None for 0.3.
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
    for _ in range(5):  # the middle of the picture depends slightly on the distance
        depth = along[:, 2] - middle[2]
        distance = float((np.abs(along[:, :2] - middle[:2]) * 1.06 / tangent - depth[:, None]).max())
        seen = (along[:, :2] - middle[:2]) / (distance + depth)[:, None]
        middle[:2] += distance * (seen.min(axis=0) + seen.max(axis=0)) / 2
    eye = middle[0] * right + middle[1] * up + (middle[2] - distance) * forward
    return Camera(eye, forward, right, tangent, size, False)


def direction(azimuth_deg: float, elevation_deg: float) -> Floats:
    """Return the (3,) unit vector of an azimuth from x to y and an elevation from the horizontal."""
    a, e = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


@dataclass(frozen=True, slots=True, eq=False)
class DepthImage:
    """Distance at each pixel of a camera.

    Attributes:
        camera: of the picture.
        distance: (P,) along the ray of each pixel, row by row [m]; inf without a hit.
    """

    camera: Camera
    distance: Floats


ColourOf = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Colours (N, 3) from 0 to 1 and distances (N,) [m] for origins and directions (N, 3) of rays."""


def render(camera: Camera, colour_of: ColourOf) -> tuple[Image.Image, DepthImage]:
    """Draw the picture of a camera with one ray per pixel, or four if the colour differs from a neighbour's."""
    columns, rows = camera.size
    colour, distance = np.empty((columns * rows, 3)), np.empty(columns * rows)
    for pixels in _blocks(np.arange(columns * rows), _BLOCK):
        colour[pixels], distance[pixels] = colour_of(*camera.rays(pixels))
    for pixels in _blocks(np.flatnonzero(_edges(colour.reshape(rows, columns, 3))), _BLOCK):
        around = [colour_of(*camera.rays(pixels, (x, y)))[0] for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
        colour[pixels] = sum(around) / len(around)
    values = (255 * colour.reshape(rows, columns, 3).clip(0, 1) + 0.5).astype(np.uint8)
    return Image.fromarray(values), DepthImage(camera, distance)


def _blocks(pixels: Ints, size: int) -> list[Ints]:
    """Return the pixels in blocks that fit into the core's cache."""
    return [pixels[start : start + size] for start in range(0, len(pixels), size)]


def _edges(grid: Floats) -> NDArray[np.bool_]:
    """Return (rows, columns) whether the colour (rows, columns, 3) differs from a neighbour's."""
    edge = np.zeros(grid.shape[:2], dtype=np.bool_)
    for channel in np.moveaxis(grid, 2, 0):
        across = np.abs(np.diff(channel, axis=1)) > _EDGE_CONTRAST
        down = np.abs(np.diff(channel, axis=0)) > _EDGE_CONTRAST
        edge[:, :-1] |= across
        edge[:, 1:] |= across
        edge[:-1] |= down
        edge[1:] |= down
    return edge


def render_mesh(camera: Camera, caster: RayCaster, normals: Floats, colours: Floats) -> tuple[Image.Image, DepthImage]:
    """Render a mesh on white by a parallel camera.

    Args:
        camera: parallel.
        caster: of the mesh.
        normals: (F, 3) of its faces.
        colours: (F, 3) of its faces, from 0 to 1.
    """
    facing = normals @ -camera.forward

    def colour_of(origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        hits = caster.first_hit(origins, directions)
        picture, hit = np.ones((len(origins), 3)), np.flatnonzero(hits.face >= 0)
        face = hits.face[hit]
        picture[hit] = shade(np.take(colours, face, axis=0), facing[face])
        return picture, hits.distance

    return render(camera, colour_of)


def shade(colour: Floats, facing: Floats) -> Floats:
    """Return (N, 3) colours, darker where the surface is inclined to the ray.

    Args:
        colour: (N, 3) from 0 to 1.
        facing: (N,) cosine between normal and direction to the eye; negative for a surface seen from behind.
    """
    lit = colour * (0.42 + 0.58 * np.abs(facing))[:, None]
    behind = np.flatnonzero(facing < 0)
    lit[behind] = 0.35 * lit[behind] + 0.25
    return np.asarray(lit)


def draw_lines(
    image: Image.Image, depth: DepthImage, segments: Floats, colour: str, *, width: int = 1, hidden: str | None = None
) -> None:
    """Draw segments over a picture, behind a surface in another colour or not at all.

    Args:
        image: the picture.
        depth: of the picture.
        segments: (N, 2, 3) [m].
        colour: of visible pieces.
        width: of a line [pixels].
        hidden: colour of pieces behind a surface; None leaves them out.
    """
    if not len(segments):
        return
    steps = np.linspace(0, 1, _STEPS + 1)[None, :, None]
    along = segments[:, None, 0] * (1 - steps) + segments[:, None, 1] * steps
    at = depth.camera.project(along.reshape(-1, 3)).reshape(len(segments), -1, 3)
    columns, rows = depth.camera.size
    middle = (at[:, 1:] + at[:, :-1]) / 2
    column = middle[..., 0].astype(np.int64).clip(0, columns - 1)
    row = middle[..., 1].astype(np.int64).clip(0, rows - 1)
    front = middle[..., 2] <= depth.distance[row * columns + column] * (1 + _DEPTH_TOLERANCE)
    draw = ImageDraw.Draw(image)
    for i in range(len(segments)):
        for first, last, is_visible in _runs(front[i]):
            if is_visible or hidden:
                ends = [tuple(at[i, first, :2]), tuple(at[i, last, :2])]
                draw.line(ends, fill=colour if is_visible else hidden, width=width)


def frustum_corners(opening_deg: tuple[float, float], far: float) -> Floats:
    """Return the (4, 3) far corners of a field of view [m], scanner frame."""
    x, y = np.tan(np.radians(opening_deg) / 2)
    return far * np.array([[-x, -y, 1.0], [x, -y, 1.0], [x, y, 1.0], [-x, y, 1.0]])


def pyramid_edges(poses: Floats, corners: Floats) -> Floats:
    """Return (n * 8, 2, 3) edges from the tip and around the base of a pyramid at each of (n, 4, 4) poses [m]."""
    base = np.einsum("nij,kj->nki", poses[:, :3, :3], corners) + poses[:, None, :3, 3]
    tip = np.broadcast_to(poses[:, None, :3, 3], base.shape)
    edges = [np.stack([tip, base], axis=2), np.stack([base, np.roll(base, -1, axis=1)], axis=2)]
    return np.asarray(np.concatenate(edges, axis=1).reshape(-1, 2, 3))


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int, bool]]:
    """Return runs of equal flags as (first, last, flag)."""
    cuts = [0, *(np.flatnonzero(flags[1:] != flags[:-1]) + 1).tolist(), len(flags)]
    return [(cuts[k], cuts[k + 1], bool(flags[cuts[k]])) for k in range(len(cuts) - 1)]


def draw_labels(image: Image.Image, places: Floats, texts: Sequence[str], size: int = 15) -> None:
    """Write texts at (N, 2) places [pixels], moved as little as needed to avoid overlaps."""
    draw, type_face, used = ImageDraw.Draw(image), font(size), list[tuple[float, float, float, float]]()
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    offsets = [(0.0, 0.0), *((r * np.cos(a), r * np.sin(a)) for r in size * np.arange(1, 9) * 0.8 for a in angles)]
    for place, text in zip(places, texts, strict=True):
        left, top, right, bottom = draw.textbbox((0, 0), text, type_face, anchor="mm")
        centres = [(place[0] + x, place[1] + y) for x, y in offsets]
        centre = next((at for at in centres if _is_free(at, right - left, bottom - top, used, image.size)), centres[0])
        used.append((*centre, right - left, bottom - top))
        if np.hypot(centre[0] - place[0], centre[1] - place[1]) > size:
            draw.line([tuple(place), centre], fill="#777777")
        draw.text(centre, text, "#111111", type_face, anchor="mm", stroke_width=2, stroke_fill="white")


def draw_dots(image: Image.Image, places: Floats, colour: str, radius: float = 4.0) -> None:
    """Draw dots at (N, 2) places [pixels]."""
    for x, y in places:
        ImageDraw.Draw(image).ellipse((x - radius, y - radius, x + radius, y + radius), colour)


def _is_free(
    at: tuple[float, float],
    width: float,
    height: float,
    used: Sequence[tuple[float, float, float, float]],
    size: tuple[int, int],
) -> bool:
    """Return whether a box about `at` is inside the picture and overlaps no used box (x, y, width, height)."""
    inside = width / 2 < at[0] < size[0] - width / 2 and height / 2 < at[1] < size[1] - height / 2
    return inside and all(
        abs(at[0] - x) > (width + w) / 2 + 2 or abs(at[1] - y) > (height + h) / 2 + 2 for x, y, w, h in used
    )


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return Pillow's built-in font."""
    return ImageFont.load_default(size)


def save_png(image: Image.Image, path: Path) -> None:
    """Write a PNG with reproducible bytes, completely or not at all.

    Raises:
        FileError: if it cannot be written.
    """
    with file_errors(f"{path} cannot be written"), atomic_write(path) as part:
        image.save(part, format="png", optimize=False, compress_level=4)
