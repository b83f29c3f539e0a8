"""What replay draws into a scene beside the model: frustum, TCP path, fresh points, contacts.

Everything is appended to an `MjvScene` as decoration, the viewer's own (`user_scn`) or that of an off-screen picture,
so both show the same. Base frame, metres.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cell.replay.model import GLYPH_SHARE, Theatre
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

Colour = tuple[float, float, float, float]

BEAM: Colour = (0.05, 0.62, 0.55, 0.20)
BEAM_EDGE: Colour = (0.02, 0.45, 0.42, 0.9)
GLYPH: Colour = (0.05, 0.55, 0.62, 0.30)
PATH: Colour = (0.10, 0.25, 0.62, 1.0)
FRESH: Colour = (0.0, 0.75, 0.45, 1.0)
EARLIER: Colour = (0.16, 0.46, 0.72, 1.0)
LOST: Colour = (0.72, 0.22, 0.16, 1.0)
CONTACT: Colour = (0.9, 0.0, 0.05, 1.0)


@dataclass(frozen=True, slots=True)
class Touch:
    """Two things that are nearer than the clearance.

    Attributes:
        names: what a reader calls them, "housing with part".
        distance: between the two [m]; below 0 where they overlap.
        position: (3,) between the two, base frame [m].
    """

    names: str
    distance: float
    position: tuple[float, float, float]

    @property
    def sentence(self) -> str:
        """For captions."""
        if self.distance <= 0:
            return f"CONTACT: {self.names}"
        return f"{1000 * self.distance:.1f} mm: {self.names}"


def add_mesh(scene: mujoco.MjvScene, model: mujoco.MjModel, mesh: int, T: Floats, rgba: Colour) -> None:
    """A mesh of the model at a pose.

    Args:
        scene: is appended to; a full scene stays as it is.
        model: holds the mesh.
        mesh: its number.
        T: (4, 4) pose of the mesh's own frame [m].
        rgba: colour.
    """
    import mujoco

    # The engine keeps a mesh about its middle, turned to its principal axes; this undoes it.
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.mesh_quat[mesh])
    position = T[:3, :3] @ model.mesh_pos[mesh] + T[:3, 3]
    geom = _geom(scene, mujoco.mjtGeom.mjGEOM_MESH, np.zeros(3), position, T[:3, :3] @ R.reshape(3, 3), rgba)
    if geom is not None:
        geom.dataid = 2 * mesh  # even numbers are meshes, odd ones their hulls


def add_frustum(scene: mujoco.MjvScene, theatre: Theatre, T_base_scanner: Floats) -> None:
    """The scanner's measuring volume: translucent sides, and edges that run back to the laser's source."""
    add_mesh(scene, theatre.model, theatre.frustum_mesh, T_base_scanner, BEAM)
    corners = theatre.frustum_corners @ T_base_scanner[:3, :3].T + T_base_scanner[:3, 3]
    near, far, source = corners[:4], corners[4:], T_base_scanner[:3, 3]
    for i in range(4):
        add_segment(scene, source, far[i], 0.0016, BEAM_EDGE)
        add_segment(scene, far[i], far[(i + 1) % 4], 0.0016, BEAM_EDGE)
        add_segment(scene, near[i], near[(i + 1) % 4], 0.0016, BEAM_EDGE)


def add_glyph(scene: mujoco.MjvScene, theatre: Theatre, T_base_scanner: Floats) -> None:
    """A view among many: the first part of its frustum, a small pyramid with its tip in the laser's source."""
    add_mesh(scene, theatre.model, theatre.glyph_mesh, T_base_scanner, GLYPH)
    far = GLYPH_SHARE * theatre.frustum_corners[4:] @ T_base_scanner[:3, :3].T + T_base_scanner[:3, 3]
    for i in range(4):
        add_segment(scene, T_base_scanner[:3, 3], far[i], 0.0012, BEAM_EDGE)
        add_segment(scene, far[i], far[(i + 1) % 4], 0.0012, BEAM_EDGE)


def add_path(scene: mujoco.MjvScene, points: Floats, radius: float) -> None:
    """A polyline through (N, 3) points as thin rods; repeated points are left out."""
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6
    for start, end in itertools.pairwise(points[np.concatenate([[True], apart])]):
        add_segment(scene, start, end, radius, PATH)


def add_segment(scene: mujoco.MjvScene, start: Floats, end: Floats, radius: float, rgba: Colour) -> None:
    """A thin rod between two points."""
    import mujoco

    geom = _geom(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.eye(3), rgba)
    if geom is not None:
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)


def add_ball(scene: mujoco.MjvScene, position: Floats, radius: float, rgba: Colour) -> None:
    """A ball."""
    import mujoco

    _geom(scene, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, radius), position, np.eye(3), rgba)


def add_label(scene: mujoco.MjvScene, position: Floats, text: str) -> None:
    """A line of text that faces the camera."""
    import mujoco

    geom = _geom(scene, mujoco.mjtGeom.mjGEOM_LABEL, np.full(3, 0.01), position, np.eye(3), (0.0, 0.0, 0.0, 1.0))
    if geom is not None:
        geom.label = text


def add_clouds(
    scene: mujoco.MjvScene, theatre: Theatre, shown: Sequence[int], fresh: int | None, data: mujoco.MjData
) -> None:
    """Points of the scans taken so far, where the part is in a state; those of the newest brighter."""
    part, T = data.body("object"), np.eye(4)
    T[:3, :3], T[:3, 3] = part.xmat.reshape(3, 3), part.xpos
    for scan in shown:
        mesh = theatre.cloud_mesh[scan]
        if mesh >= 0:
            add_mesh(scene, theatre.model, mesh, T, FRESH if scan == fresh else EARLIER)


def add_touches(scene: mujoco.MjvScene, found: Sequence[Touch]) -> None:
    """A red ball at each place that is nearer than the clearance."""
    for touch in found:
        add_ball(scene, np.array(touch.position), 0.02, CONTACT)


def touches(theatre: Theatre, data: mujoco.MjData) -> tuple[Touch, ...]:
    """What is nearer than it is guarded by at the pose of `data`, nearest first; looks with the checked shapes.

    Of what was checked as its triangles, the hull in the model only finds the shapes to look at.
    """
    import mujoco

    mujoco.mj_collision(theatre.model, data)
    found: dict[str, Touch] = {}
    for contact in data.contact[: data.ncon]:
        names = " with ".join(theatre.entities[geom] for geom in sorted(contact.geom, reverse=True))
        distance, position = float(contact.dist), contact.pos
        a, b = (int(geom) for geom in contact.geom)
        if a in theatre.shapes.nonconvex or b in theatre.shapes.nonconvex:
            points = np.zeros((2, 3))
            distance = theatre.shapes.distance(data, a, b, theatre.clearance, points=points)
            position = points.mean(axis=0)
        least = min(theatre.clearance, theatre.near.get((a, b), np.inf))
        if distance < least and (names not in found or distance < found[names].distance):
            x, y, z = (float(value) for value in position)
            found[names] = Touch(names, distance, (x, y, z))
    return tuple(sorted(found.values(), key=lambda touch: touch.distance))


def _geom(
    scene: mujoco.MjvScene, kind: int, size: Floats, position: Floats, R: Floats, rgba: Colour
) -> mujoco.MjvGeom | None:
    """The next geom of a scene; None where it is full: a picture with too few marks is better than none."""
    import mujoco

    if scene.ngeom >= scene.maxgeom:
        return None
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, size, position, np.ascontiguousarray(R).ravel(), np.array(rgba, dtype=np.float32))
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.segid = geom.objid = -1
    if rgba[3] < 1:
        geom.transparent = True
    scene.ngeom += 1
    return geom
