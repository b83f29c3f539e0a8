"""The page: one HTML file with three.js, the cell, the part, views and motion in it; no address outside, no server.

three.js is the one that trimesh carries for its own viewer. Geometry is quantised to 1/65535 of its extent and thinned
to what an eye can tell. Nothing that a user named is ever taken for markup: text goes through JSON whose `<` is escaped
and through `textContent`. Equal values give equal bytes. Base frame, metres.
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
from cell.view.packed import Layer, packed, packed_mesh, packed_motion, packed_points
from cell.view.pieces import Cell, Piece, placed
from cell.view.surface import FACES
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

_OWN_START = "var camera,controls,scene,renderer,tracklight;"  # where trimesh's own viewer begins, behind three.js
_AWAY = 1.5  # times its diagonal: from where all of arm and part is in the picture
_GLYPH = 0.16  # of a frustum's length: a view's small pyramid


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A surface with its layers, object frame [m]."""

    name: str
    mesh: TriangleMesh
    layers: Sequence[Layer] = ()


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A view that can be clicked.

    Attributes:
        number: in visiting order, from 1, with what tells it apart where the page has views of two runs.
        T_base_scanner: (4, 4) [m].
        time: of the motion, at which the scanner is there [s]; None: never.
        rows: what is said of it.
        commands: that do something with it; words as in `Play.next`.
        colour: of its frustum.
    """

    number: str
    T_base_scanner: Floats
    time: float | None
    rows: Sequence[tuple[str, str]]
    commands: Sequence[str] = ()
    colour: str = palette.SEEN[4]


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """What does not move: all that is dear to make, so that it can be made before the rest is known.

    Attributes:
        title: heading.
        cell: robot and surroundings.
        surfaces: part, and what was measured of it; coloured at first by the first layer of the first.
        toward: (3,) unit vector from the part to the eye that looks at it at first, object frame; None: the whole cell.
        watched: stamp of a page that is written again and again; "" is none.
    """

    title: str
    cell: Cell
    surfaces: Sequence[Shown] = ()
    toward: Floats | None = None
    watched: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Play:
    """What is done in front of it, and said of it.

    Attributes:
        views: in visiting order.
        motion: times (M,) [s] and joint angles (M, 6) [rad]; None: the arm stands at home.
        cloud: (P, 3) points, object frame [m].
        rows: numbers beside the picture.
        problems: sentences about what is wrong.
        notes: sentences.
        next: commands that go on from here; RUN stands for the run folder, EXECUTION for the name of the page's.
        inside: how many folders below its run folder the page lies; None: anywhere else.
        curve: picture of coverage over views, as a data URL; "": none.
    """

    views: Sequence[View] = ()
    motion: tuple[Floats, Floats] | None = None
    cloud: Floats | None = None
    rows: Sequence[tuple[str, str]] = ()
    problems: Sequence[str] = ()
    notes: Sequence[str] = ()
    next: Sequence[str] = ()
    inside: int | None = None
    curve: str = ""


def html_of(stage: Stage, play: Play) -> str:
    """The whole file."""
    return first_half(stage) + second_half(play)


def first_half(stage: Stage) -> str:
    """The file's text up to what `second_half` adds.

    Raises:
        CellError: if trimesh's viewer is not the one that this version knows.
    """
    may = (
        f"script-src 'unsafe-inline'{' file:' if stage.watched else ''}; style-src 'unsafe-inline'; img-src data: blob:"
    )
    return filled(
        text("page.html").partition("$PLAY")[0],
        HEAD=head(stage.title, "page.css", may), THREE=three(), STAGE=_json(_stage(stage)),
    )  # fmt: skip


def second_half(play: Play) -> str:
    """The rest of the file."""
    return _json(_play(play)) + filled(text("page.html").partition("$PLAY")[2], SCRIPT=text("page.js"))


def head(title: str, css: str, may: str) -> str:
    """The head of a page.

    Args:
        title: in the browser's tab.
        css: file of its own looks, behind those of all pages.
        may: what the page may do, as a content security policy says it; all else is forbidden.
    """
    return filled(text("head.html"), MAY=may, TITLE=html.escape(title), CSS=text("look.css") + text(css))


def filled(template: str, **values: str) -> str:
    """A template with `$NAME` filled in; what is filled in is never looked at again."""
    return re.sub(r"\$([A-Z]+)", lambda found: values[found[1]], template)


def text(name: str) -> str:
    """A file beside this module."""
    return (resources.files("cell.view") / name).read_text(encoding="utf-8")


def _json(content: Mapping[str, object]) -> str:
    """JSON that stays text inside a script element, whatever is in it."""
    written = json.dumps(content, default=_plain, separators=(",", ":"), allow_nan=False)
    return written.replace("<", "\\u003c")


def _plain(value: object) -> object:
    """What the script gets of a value: arrays without the dust behind the last digit that counts, meshes packed."""
    if isinstance(value, np.ndarray):
        return (np.round(value, 9) + 0.0).tolist()
    if isinstance(value, TriangleMesh):
        return packed_mesh(value)
    if isinstance(value, Piece):
        mesh = thinned(TriangleMesh(value.vertices, value.faces))
        return {"name": value.name, "link": value.link, "rgb": value.rgb, "mesh": mesh}
    known = _fields(value)
    if isinstance(value, Layer):
        width = value.values.shape[1] if value.values.ndim > 1 else 1
        return {
            **known,
            "values": packed(value.values, "u1" if value.values.dtype == np.uint8 else "u2"),
            "width": width,
        }
    return known


def _fields(value: Any) -> dict[str, object]:
    return {each.name: getattr(value, each.name) for each in fields(value)}


def thinned(mesh: TriangleMesh) -> TriangleMesh:
    """A mesh for looking: decimated above `FACES`."""
    return decimate(mesh, FACES) if len(mesh.faces) > FACES else mesh


def _stage(stage: Stage) -> Mapping[str, object]:
    cell = stage.cell
    middle, near = cell.T_base_object[:3, 3], 1.0
    if stage.surfaces:
        mesh = stage.surfaces[0].mesh
        centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        middle, near = cell.T_base_object[:3, :3] @ centre + cell.T_base_object[:3, 3], 2.6 * mesh.diagonal
    arm = [p.vertices for p in placed(cell.pieces, cell.arm.links(cell.arm.home)) if p.name in ("robot", "scanner")]
    whole = np.concatenate([*arm, [middle - near / 4, middle + near / 4]])
    low, high = whole.min(axis=0), whole.max(axis=0)
    eye = np.array([np.cos(a := np.arctan2(middle[1], middle[0]) - 0.9), np.sin(a), np.tan(0.35)])
    if stage.toward is not None:
        eye = cell.T_base_object[:3, :3] @ stage.toward
    return {
        **{name: value for name, value in _fields(stage).items() if name != "cell"},
        **_fields(cell),
        "look": {
            "target": (low + high) / 2,
            "distance": _AWAY * float(np.linalg.norm(high - low)),
            "azimuth": float(np.arctan2(eye[1], eye[0])),
            "elevation": float(np.arctan2(eye[2], np.hypot(eye[0], eye[1]))),
            "close": stage.toward is not None,
            "part": middle,
            "near": near,
        },
        "floor": next((float(piece.vertices[0, 2]) for piece in cell.pieces if piece.name == "floor"), 0.0),
        "palette": _PALETTE,
        "glyph": _GLYPH,
    }


def _play(play: Play) -> Mapping[str, object]:
    stops = [view.time for view in play.views if view.time is not None]
    return {
        **_fields(play),
        "motion": None if play.motion is None else packed_motion(*play.motion, stops),
        "cloud": None if play.cloud is None or not len(play.cloud) else packed_points(play.cloud),
    }


_PALETTE = {
    "open": [palette.OPEN],
    "seen": palette.SEEN,
    "measured": [palette.MEASURED],
    "lengths": palette.LENGTHS,
    "signed": palette.SIGNED,
    "plain": ["#d6ccb8"],
    "chosen": [palette.ORANGE],
    "cloud": [palette.GREEN],
}


@cache
def three() -> str:
    """three.js, out of the page that trimesh makes; trimesh itself, which takes 0.4 s, is not imported for it.

    Raises:
        CellError: if trimesh's viewer is not the one that this version knows.
    """
    found = find_spec("trimesh")
    folders = found.submodule_search_locations if found else None
    if not folders:
        raise CellError("trimesh is missing, and pages need its three.js; install trimesh 5.2")
    with ZipFile(Path(folders[0]) / "resources" / "templates" / "viewer.zip") as archive:
        viewer = archive.read("viewer.html.template").decode("utf-8")
    script, known, _ = viewer.partition("<script>")[2].partition(_OWN_START)
    if not known or "THREE" not in script:
        raise CellError("this version of trimesh has another viewer, and pages need its three.js; install trimesh 5.2")
    return script
