"""Marks that replay adds to the model: frustum, TCP path, scanned points, clearance violations.

All marks are appended to an `MjvScene` as decoration: the viewer's own (`user_scn`) or that of an off-screen picture,
so both show the same. Base frame, metres.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cell.robot.model import frame_of
from cell.view.rays import GLYPH_SHARE
from cell.view.replay_model import ReplayModel
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

Colour = tuple[float, float, float, float]

BEAM: Colour = (0.05, 0.62, 0.55, 0.20)
BEAM_EDGE: Colour = (0.02, 0.45, 0.42, 0.9)
GLYPH: Colour = (0.05, 0.55, 0.62, 0.30)
PATH: Colour = (0.10, 0.25, 0.62, 1.0)
NEWEST: Colour = (0.0, 0.75, 0.45, 1.0)
EARLIER: Colour = (0.16, 0.46, 0.72, 1.0)
UNREACHABLE: Colour = (0.72, 0.22, 0.16, 1.0)
CONTACT: Colour = (0.9, 0.0, 0.05, 1.0)


@dataclass(frozen=True, slots=True)
class ClearanceViolation:
    """Two bodies whose distance is below the required clearance.

    Attributes:
        names: of both, such as "housing with part".
        distance: between them [m]; negative if they overlap.
        position: (3,) between them, base frame [m].
    """

    names: str
    distance: float
    position: tuple[float, float, float]

    @property
    def sentence(self) -> str:
        """Text for captions."""
        if self.distance <= 0:
            return f"CONTACT: {self.names}"
        return f"{1000 * self.distance:.1f} mm: {self.names}"


def add_mesh(scene: mujoco.MjvScene, model: mujoco.MjModel, mesh: int, T: Floats, rgba: Colour) -> None:
    """Draw a mesh of the model at a (4, 4) pose [m] of the mesh's own frame; a full scene stays unchanged."""
    import mujoco

    # The engine stores a mesh relative to its centre and its principal axes; this restores the original frame.
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.mesh_quat[mesh])
    position = T[:3, :3] @ model.mesh_pos[mesh] + T[:3, 3]
    geom = _geom(scene, mujoco.mjtGeom.mjGEOM_MESH, np.zeros(3), position, T[:3, :3] @ R.reshape(3, 3), rgba)
    if geom is not None:
        geom.dataid = 2 * mesh  # even numbers are meshes, odd ones their hulls


def add_frustum(scene: mujoco.MjvScene, replay_model: ReplayModel, T_base_scanner: Floats) -> None:
    """Draw the scanner's measuring volume: translucent sides, and edges back to the laser's source."""
    add_mesh(scene, replay_model.model, replay_model.frustum_mesh, T_base_scanner, BEAM)
    corners = replay_model.frustum_corners @ T_base_scanner[:3, :3].T + T_base_scanner[:3, 3]
    near, far, source = corners[:4], corners[4:], T_base_scanner[:3, 3]
    for i in range(4):
        add_segment(scene, source, far[i], 0.0016, BEAM_EDGE)
        add_segment(scene, far[i], far[(i + 1) % 4], 0.0016, BEAM_EDGE)
        add_segment(scene, near[i], near[(i + 1) % 4], 0.0016, BEAM_EDGE)


def add_glyph(scene: mujoco.MjvScene, replay_model: ReplayModel, T_base_scanner: Floats) -> None:
    """Draw a view as a small pyramid with its tip in the laser's source."""
    add_mesh(scene, replay_model.model, replay_model.glyph_mesh, T_base_scanner, GLYPH)
    far = GLYPH_SHARE * replay_model.frustum_corners[4:] @ T_base_scanner[:3, :3].T + T_base_scanner[:3, 3]
    for i in range(4):
        add_segment(scene, T_base_scanner[:3, 3], far[i], 0.0012, BEAM_EDGE)
        add_segment(scene, far[i], far[(i + 1) % 4], 0.0012, BEAM_EDGE)


def add_path(scene: mujoco.MjvScene, points: Floats, radius: float) -> None:
    """Draw a polyline through (N, 3) points as thin rods; repeated points are left out."""
    is_new = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6
    for start, end in itertools.pairwise(points[np.concatenate([[True], is_new])]):
        add_segment(scene, start, end, radius, PATH)


def add_segment(scene: mujoco.MjvScene, start: Floats, end: Floats, radius: float, rgba: Colour) -> None:
    """Draw a thin rod between two points."""
    import mujoco

    geom = _geom(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.eye(3), rgba)
    if geom is not None:
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)


def add_ball(scene: mujoco.MjvScene, position: Floats, radius: float, rgba: Colour) -> None:
    """Draw a ball."""
    import mujoco

    _geom(scene, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, radius), position, np.eye(3), rgba)


def add_label(scene: mujoco.MjvScene, position: Floats, text: str) -> None:
    """Draw a line of text that faces the camera."""
    import mujoco

    geom = _geom(scene, mujoco.mjtGeom.mjGEOM_LABEL, np.full(3, 0.01), position, np.eye(3), (0.0, 0.0, 0.0, 1.0))
    if geom is not None:
        geom.label = text


def add_clouds(
    scene: mujoco.MjvScene, replay_model: ReplayModel, scans: Sequence[int], newest: int | None, data: mujoco.MjData
) -> None:
    """Draw the points of the given scans at the part's pose in `data`; the newest scan is brighter."""
    T = frame_of(data.body("object"))
    for scan in scans:
        mesh = replay_model.cloud_meshes[scan]
        if mesh >= 0:
            add_mesh(scene, replay_model.model, mesh, T, NEWEST if scan == newest else EARLIER)


def find_violations(replay_model: ReplayModel, data: mujoco.MjData) -> tuple[ClearanceViolation, ...]:
    """Return the clearance violations at the pose of `data`, smallest distance first, with the checked shapes.

    For a body that was checked as triangles, its hull in the model only selects the pairs to measure.
    """
    import mujoco

    mujoco.mj_collision(replay_model.model, data)
    violations: dict[str, ClearanceViolation] = {}
    for contact in data.contact[: data.ncon]:
        names = " with ".join(replay_model.geom_names[geom] for geom in sorted(contact.geom, reverse=True))
        distance, position = float(contact.dist), contact.pos
        a, b = (int(geom) for geom in contact.geom)
        if a in replay_model.shapes.nonconvex or b in replay_model.shapes.nonconvex:
            points = np.zeros((2, 3))
            distance = replay_model.shapes.distance(data, a, b, replay_model.clearance, points=points)
            position = points.mean(axis=0)
        required = min(replay_model.clearance, replay_model.pair_clearances.get((a, b), np.inf))
        if distance < required and (names not in violations or distance < violations[names].distance):
            x, y, z = (float(value) for value in position)
            violations[names] = ClearanceViolation(names, distance, (x, y, z))
    return tuple(sorted(violations.values(), key=lambda violation: violation.distance))


def _geom(
    scene: mujoco.MjvScene, kind: int, size: Floats, position: Floats, R: Floats, rgba: Colour
) -> mujoco.MjvGeom | None:
    """Return the next geom of a scene, or None if it is full: missing marks are better than no picture."""
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
