"""Page of a run: one HTML file with three.js, cell, part, views and motion; needs no server and no network.

three.js comes from trimesh's own viewer. Geometry is quantised to 1/65535 of its extent and reduced to the visible
resolution. User-defined names are never parsed as markup: text goes through JSON with escaped `<` and through
`textContent`. Equal values give equal bytes. Base frame, metres.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from cell.errors import CellError
from cell.view import palette
from cell.view.packed import Layer, pack_array, pack_mesh, pack_motion, pack_points
from cell.view.pieces import CellGeometry, Piece, place_pieces
from cell.view.rays import GLYPH_SHARE
from cell.view.surface import MAX_FACES
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

_VIEWER_START = "var camera,controls,scene,renderer,tracklight;"  # end of three.js, start of trimesh's own viewer
_DISTANCE_FACTOR = 1.5  # times the diagonal of arm and part: distance at which both are in the picture


@dataclass(frozen=True, slots=True, eq=False)
class PageSurface:
    """A surface with its layers, object frame [m]."""

    name: str
    mesh: TriangleMesh
    layers: Sequence[Layer] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PageView:
    """A selectable view.

    Attributes:
        number: in visiting order, from 1, with the name of the run if the page has views of two runs.
        T_base_scanner: (4, 4) [m].
        time: of the motion, at which the scanner is there [s]; None if never.
        rows: names and values in the panel.
        commands: for this view, with placeholders as in `PageContents.next_commands`.
        colour: of its frustum.
    """

    number: str
    T_base_scanner: Floats
    time: float | None
    rows: Sequence[tuple[str, str]]
    commands: Sequence[str] = ()
    colour: str = palette.SEEN[4]


@dataclass(frozen=True, slots=True, eq=False)
class PageScene:
    """Static geometry, which is expensive and can be written before the contents are known.

    Attributes:
        title: heading.
        cell: robot and surroundings.
        surfaces: the part and the measured surface; the first layer of the first surface is selected.
        toward: (3,) unit vector from the part to the initial camera, object frame; None: the page chooses a free side.
        opens_on: title of the selected layer; "" shows the whole cell in the first layer.
        is_alone: True if only the surface is visible at first, without robot and surroundings.
        watch_stamp: version of a page that is updated repeatedly, or "".
    """

    title: str
    cell: CellGeometry
    surfaces: Sequence[PageSurface] = ()
    toward: Floats | None = None
    opens_on: str = ""
    is_alone: bool = False
    watch_stamp: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PageContents:
    """Views, motion, points and text of a page.

    Attributes:
        views: in visiting order.
        motion: times (M,) [s] and joint angles (M, axes) [rad]; None for an arm at home.
        cloud: (P, 3) points, object frame [m].
        rows: names and numbers in the panel.
        characteristics: with `name`, `colour`, `rows`, the `place` that a click shows (object frame [m]) or None, and
            the `points` of the feature: x, y, z and deviation [mm].
        problems: sentences about errors.
        notes: sentences.
        next_commands: with the placeholders RUN for the run folder and EXECUTION for the execution's name.
        folder_depth: number of folders between the run folder and the page; None for a page elsewhere.
        curve: picture of coverage over views as a data URL, or "".
    """

    views: Sequence[PageView] = ()
    motion: tuple[Floats, Floats] | None = None
    cloud: Floats | None = None
    rows: Sequence[tuple[str, str]] = ()
    characteristics: Sequence[Mapping[str, object]] = ()
    problems: Sequence[str] = ()
    notes: Sequence[str] = ()
    next_commands: Sequence[str] = ()
    folder_depth: int | None = None
    curve: str = ""


def render_page(scene: PageScene, contents: PageContents) -> str:
    """Return the complete HTML text."""
    return first_half(scene) + second_half(contents)


def first_half(scene: PageScene) -> str:
    """Return the HTML text up to the contents.

    Raises:
        CellError: if this version of trimesh has an unknown viewer.
    """
    scripts = "'unsafe-inline' file:" if scene.watch_stamp else "'unsafe-inline'"
    policy = f"script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:"
    return fill_template(
        resource_text("page.html").partition("$CONTENTS")[0],
        HEAD=page_head(scene.title, "page.css", policy),
        THREE=three_js(),
        SCENE=_dump_json(_scene_json(scene)),
    )


def second_half(contents: PageContents) -> str:
    """Return the HTML text from the contents on."""
    script = resource_text("page.js") + resource_text("tools.js")
    tail = fill_template(resource_text("page.html").partition("$CONTENTS")[2], SCRIPT=script)
    return _dump_json(_contents_json(contents)) + tail


def page_head(title: str, css: str, policy: str) -> str:
    """Return the head of a page.

    Args:
        title: in the browser's tab.
        css: style sheet of this kind of page, added to the common one.
        policy: permissions of the content security policy; everything else is forbidden.
    """
    style = resource_text("look.css") + resource_text(css)
    return fill_template(resource_text("head.html"), POLICY=policy, TITLE=html.escape(title), CSS=style)


def fill_template(template: str, **values: str) -> str:
    """Replace each `$NAME` of a template in one pass: `$` in a value has no effect."""
    return re.sub(r"\$([A-Z]+)", lambda match: values[match[1]], template)


def resource_text(name: str) -> str:
    """Return the text of a file in this package."""
    return (resources.files("cell.view") / name).read_text(encoding="utf-8")


def thin_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """Return a mesh for drawing, decimated above `MAX_FACES`."""
    return decimate(mesh, MAX_FACES) if len(mesh.faces) > MAX_FACES else mesh


def _dump_json(content: Mapping[str, object]) -> str:
    """Return JSON that cannot end the script element that contains it."""
    written = json.dumps(content, default=_to_json, separators=(",", ":"), allow_nan=False)
    return written.replace("<", "\\u003c")


def _to_json(value: object) -> object:
    """Return a value for JSON: rounded arrays, packed meshes, fields of dataclasses."""
    if isinstance(value, np.ndarray):
        return (np.round(value, 9) + 0.0).tolist()
    if isinstance(value, TriangleMesh):
        return pack_mesh(value)
    if isinstance(value, Piece):
        mesh = thin_mesh(TriangleMesh(value.vertices, value.faces))
        return {"name": value.name, "link": value.link, "rgb": value.rgb, "mesh": mesh}
    known = _fields(value)
    if isinstance(value, Layer):
        width = value.values.shape[1] if value.values.ndim > 1 else 1
        return {
            **known,
            "values": pack_array(value.values, "u1" if value.values.dtype == np.uint8 else "u2"),
            "width": width,
        }
    return known


def _fields(value: Any) -> dict[str, object]:
    return {each.name: getattr(value, each.name) for each in fields(value)}


def _scene_json(scene: PageScene) -> Mapping[str, object]:
    cell = scene.cell
    middle, part_distance = cell.T_base_object[:3, 3], 1.0
    if scene.surfaces:
        mesh = scene.surfaces[0].mesh
        centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        middle = cell.T_base_object[:3, :3] @ centre + cell.T_base_object[:3, 3]
        part_distance = 2.2 * mesh.diagonal
    placed = place_pieces(cell.pieces, cell.arm.link_poses(cell.arm.home))
    arm = [piece.vertices for piece in placed if piece.name in ("robot", "scanner")]
    points = np.concatenate([*arm, [middle - part_distance / 4, middle + part_distance / 4]])
    low, high = points.min(axis=0), points.max(axis=0)
    eye = np.array([np.cos(a := np.arctan2(middle[1], middle[0]) - 0.9), np.sin(a), np.tan(0.35)])
    if scene.toward is not None:
        eye = cell.T_base_object[:3, :3] @ scene.toward
    return {
        **{name: value for name, value in _fields(scene).items() if name != "cell"},
        **_fields(cell),
        "camera": {
            "target": (low + high) / 2,
            "distance": _DISTANCE_FACTOR * float(np.linalg.norm(high - low)),
            "azimuth": float(np.arctan2(eye[1], eye[0])),
            "elevation": float(np.arctan2(eye[2], np.hypot(eye[0], eye[1]))),
            "starts_at_part": bool(scene.toward is not None or scene.opens_on),
            "is_free": scene.toward is None,
            "part": middle,
            "part_distance": part_distance,
        },
        "floor": next((float(piece.vertices[0, 2]) for piece in cell.pieces if piece.name == "floor"), 0.0),
        "palette": _PALETTE,
        "glyph": GLYPH_SHARE,
    }


def _contents_json(contents: PageContents) -> Mapping[str, object]:
    stops = [view.time for view in contents.views if view.time is not None]
    return {
        **_fields(contents),
        "motion": None if contents.motion is None else pack_motion(*contents.motion, stops),
        "cloud": None if contents.cloud is None or not len(contents.cloud) else pack_points(contents.cloud),
    }


_PALETTE = {
    "open": [palette.OPEN],
    "seen": palette.SEEN,
    "measured": [palette.MEASURED],
    "ramps": palette.RAMPS,
    "plain": ["#d6ccb8"],
    "chosen": [palette.ORANGE],
    "cloud": [palette.GREEN],
    "path": [palette.PURPLE],
}


@cache
def three_js() -> str:
    """Return the three.js of trimesh's viewer, without importing trimesh, which takes 0.4 s.

    Raises:
        CellError: if this version of trimesh has an unknown viewer.
    """
    spec = find_spec("trimesh")
    folders = spec.submodule_search_locations if spec else None
    if not folders:
        raise CellError("trimesh is missing, but pages need its three.js; install trimesh 5.2")
    with ZipFile(Path(folders[0]) / "resources" / "templates" / "viewer.zip") as archive:
        viewer = archive.read("viewer.html.template").decode("utf-8")
    script, known, _ = viewer.partition("<script>")[2].partition(_VIEWER_START)
    if not known or "THREE" not in script:
        raise CellError("this trimesh has an unknown viewer, but pages need its three.js; install trimesh 5.2")
    return script
