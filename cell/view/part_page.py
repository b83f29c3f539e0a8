"""`cell part`: page and picture of a part; CAD faces are coloured by kind and numbered."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cell.part.cad import CadFace, CadModel, SurfaceKind
from cell.part.workpiece import Workpiece
from cell.view import rays
from cell.view.packed import Layer, pack_array
from cell.view.page import PageContents, PageScene, PageSurface, render_page, resource_text, thin_mesh
from cell.view.palette import REASONS, rgb
from cell.view.pieces import ArmChain, CellGeometry
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints

_COLOURS = dict(zip(SurfaceKind, ("#d9dee3", *REASONS[1:6]), strict=True))
_SIDES = ((-60, 35), (120, 35), (-60, -35), (120, -35))
_PANEL = (900, 700)


def face_rows(face: CadFace, area: float, centre: Floats) -> list[tuple[str, str]]:
    """Return names and values of a face: kind, size, direction, area [m^2] and centre (3,) [m]."""
    rows = [("face", f"{face.number}, {face.kind}")]
    rows += [("size", face.dimensions)] if face.dimensions else []
    if face.axis is not None:
        rows.append(("normal" if face.kind == SurfaceKind.PLANE else "axis", _format_numbers(face.axis, 4)))
    return [*rows, ("area", f"{1e6 * area:.6g} mm²"), ("middle", f"{_format_numbers(1000 * centre, 2)} mm")]


def part_page(part: Workpiece, rows: list[tuple[str, str]], next_command: str) -> str:
    """Return the page of a part; for a CAD model, a click selects a face.

    Args:
        part: object frame.
        rows: names and numbers in the panel.
        next_command: suggested next command.
    """
    notes = [finding.sentence for finding in part.findings]
    if (cad := part.cad) is None:
        scene = PageScene(
            part.name, _empty_cell(), [PageSurface("part", thin_mesh(part.reference))], rays.direction(-60, 35)
        )
        return render_page(scene, PageContents(rows=rows, notes=notes, next_commands=[next_command]))
    mesh, face_of_vertex = split_vertices(part.reference, cad.of_triangle)
    layers = [_kind_layer(cad, part.reference, face_of_vertex)]
    areas, centres = cad.areas(part.reference), cad.centres(part.reference)
    items = [
        {"number": face.number, "rows": face_rows(face, area, centre)}
        for face, area, centre in zip(cad.faces, areas, centres, strict=True)
    ]
    return selectable_page(part.name, mesh, layers, "Face", items, face_of_vertex, rows, notes, [next_command])


def selectable_page(
    title: str,
    mesh: TriangleMesh,
    layers: Sequence[Layer],
    what: str,
    items: Sequence[Mapping[str, object]],
    item_of_vertex: Ints,
    rows: Sequence[tuple[str, str]],
    notes: Sequence[str] = (),
    next_commands: Sequence[str] = (),
) -> str:
    """Return a page on which a click selects an item of the surface and shows its rows.

    Args:
        title: of the page.
        mesh: surface with separate vertices for each item.
        layers: of the surface.
        what: name of an item.
        items: with `number` and `rows`.
        item_of_vertex: (V,) index in `items`.
        rows: names and numbers in the panel.
        notes: sentences.
        next_commands: suggested next commands.
    """
    scene = PageScene(title, _empty_cell(), [PageSurface("part", mesh, layers)], rays.direction(-60, 35))
    page = render_page(scene, PageContents(rows=rows, notes=notes, next_commands=next_commands))
    content = {"what": what, "faces": items, "face_of_vertex": pack_array(item_of_vertex, "u4")}
    text = json.dumps(content).replace("<", "\\u003c")
    script = f'<script type="application/json" id="faces">{text}</script>\n'
    script += f"<script>\n{resource_text('part.js')}</script>\n"
    return page.replace("</body>", f"{script}</body>")


def faces_picture(path: Path, part: Workpiece, cad: CadModel) -> None:
    """Draw the part from four sides with its faces in the colours of their kinds and with their numbers.

    Args:
        path: PNG to write.
        part: object frame.
        cad: its faces.
    """
    brightness = 1 - 0.12 * (cad.of_triangle % 2)  # distinguishes neighbours of one kind
    colours = np.array([rgb(_COLOURS[face.kind]) for face in cad.faces])[cad.of_triangle] * brightness[:, None]
    draw_numbered(path, part.reference, cad.of_triangle, colours, [str(face.number) for face in cad.faces])


def draw_numbered(
    path: Path, mesh: TriangleMesh, item_of_triangle: NDArray[np.integer], colours: Floats, labels: Sequence[str]
) -> None:
    """Draw a surface from four sides with labels on its items.

    Args:
        path: PNG to write.
        mesh: surface.
        item_of_triangle: (F,) index in `labels`; -1 for none.
        colours: (F, 3) red, green, blue.
        labels: of the items.
    """
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    sheet = Image.new("RGB", (2 * _PANEL[0], 2 * _PANEL[1]), "white")
    for k, (azimuth, elevation) in enumerate(_SIDES):
        camera = rays.fit_camera(mesh.vertices, rays.direction(azimuth, elevation), _PANEL, parallel=True)
        image, _ = rays.render_mesh(camera, caster, mesh.normals, colours)
        hits = caster.first_hit(*camera.rays())
        seen = np.where(hits.face >= 0, item_of_triangle[hits.face], -1).reshape(_PANEL[::-1])
        places, names = [], []
        for index in np.unique(seen[seen >= 0]).tolist():
            row, column = np.nonzero(seen == index)
            nearest = np.argmin(np.hypot(row - row.mean(), column - column.mean()))
            places.append((column[nearest], row[nearest]))
            names.append(labels[index])
        if places:
            rays.draw_labels(image, np.array(places, dtype=np.float64), names, 11)
        sheet.paste(image, (k % 2 * _PANEL[0], k // 2 * _PANEL[1]))
    rays.save_png(sheet, path)


def split_vertices(mesh: TriangleMesh, item_of_triangle: NDArray[np.integer]) -> tuple[TriangleMesh, Ints]:
    """Return the surface with separate vertices for each item, and the item of each vertex."""
    corners = np.stack([np.repeat(item_of_triangle, 3).astype(np.int64), mesh.faces.ravel()], axis=1)
    pairs, place = np.unique(corners, axis=0, return_inverse=True)
    return TriangleMesh(mesh.vertices[pairs[:, 1]], place.reshape(-1, 3).astype(np.int32)), pairs[:, 0]


def _kind_layer(cad: CadModel, mesh: TriangleMesh, face_of_vertex: Ints) -> Layer:
    """Return the layer of kinds of surface."""
    order, areas, counts = list(SurfaceKind), cad.areas(mesh), cad.counts()
    kind = np.array([order.index(face.kind) for face in cad.faces])
    share = np.bincount(kind, weights=areas, minlength=len(order)) / areas.sum()
    legend = [
        (f"{counts.get(each, 0)} x {each} ({100 * part:.2f} %)", _COLOURS[each])
        for each, part in zip(order, share, strict=True)
    ]
    return Layer("Kind of surface", "named", kind[face_of_vertex].astype(np.uint8), named=legend)


def _empty_cell() -> CellGeometry:
    """Return a cell without pieces."""
    arm = ArmChain(
        T_parent_link=np.tile(np.eye(4), (6, 1, 1)),
        parent=np.arange(6),
        driver=np.arange(6),
        ratio=np.ones(6),
        reference=np.zeros(6),
        axis=np.tile([0.0, 0.0, 1.0], (6, 1)),
        T_link_scanner=np.eye(4),
        home=np.zeros(6),
        limits=np.tile([-np.pi, np.pi], (6, 1)),
    )
    return CellGeometry((), arm, np.eye(4), np.zeros((4, 3)), 0, np.eye(4))


def _format_numbers(values: Floats, digits: int) -> str:
    return ", ".join(f"{value + 0.0:.{digits}f}".rstrip("0").rstrip(".") for value in np.round(values, digits))
