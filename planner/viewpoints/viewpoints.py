"""Candidate viewpoints: poses of the scanner from which the part may be measured (Section 3.4).

A viewpoint is one column of the measurability matrix: K poses of the scanner in the object frame, K = 1 for an area
scanner. The scanner's origin is the laser source, +z the viewing direction, +x from source to sensor (the baseline).

Roll turns the scanner about its viewing axis. At roll 0 the baseline is as parallel as possible to the object's z axis
(to its x axis where the view is along z); a positive roll turns the baseline from scanner +x towards scanner +y, right
handed about the viewing direction: clockwise for someone who looks along with the scanner. Metres and radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.surface.mesh import TriangleMesh
from planner.values import Bools, Floats, Ints32, Value, readonly

_ALONG_Z = 1e-3  # sine below which a view counts as along z: a flat top's normals scatter by less in a float32 mesh


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints(Value):
    """Candidate viewpoints.

    Attributes:
        T_object_scanner: (V, K, 4, 4) poses of the scanner [m].
        face: (V,) int32 planning face that the viewpoint was made for, -1 where it was made for none.
        standoff: (V,) distance from the source to the point it is aimed at [m].
        roll: (V,) angle about the viewing axis [rad].
    """

    T_object_scanner: Annotated[Floats, "V K 4 4"]
    face: Annotated[Ints32, "V"]
    standoff: Annotated[Floats, "V"]
    roll: Annotated[Floats, "V"]

    def __len__(self) -> int:
        return len(self.T_object_scanner)


def looking_at(
    targets: Floats, outward: Floats, face: NDArray[np.integer], standoffs: Sequence[float], rolls: Sequence[float]
) -> Viewpoints:
    """Views of given points from given directions; standoffs and rolls change fastest, the rolls last.

    Args:
        targets: (N, 3) points to look at [m], object frame.
        outward: (N, 3) unit directions from the points to the scanner.
        face: (N,) planning face of each point, -1 for none.
        standoffs: distances from point to source [m], > 0.
        rolls: angles about the viewing axis [rad].

    Raises:
        PlannerError: if a standoff is not positive, or there is no standoff or no roll.
    """
    distances, angles = _positive("standoffs", standoffs), _angles(rolls)
    rotations = _look_along(-outward)
    cos, sin, zero = np.cos(angles), np.sin(angles), np.zeros(len(angles))
    about_z = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1], axis=1).reshape(-1, 3, 3)
    shape = (len(targets), len(distances), len(angles))
    poses = np.zeros((*shape, 4, 4))
    poses[..., :3, :3] = np.einsum("nij,rjk->nrik", rotations, about_z)[:, None]
    poses[..., :3, 3] = (targets[:, None] + distances[:, None] * outward[:, None])[:, :, None]
    poses[..., 3, 3] = 1.0
    return Viewpoints(
        poses.reshape(-1, 1, 4, 4),
        np.broadcast_to(np.asarray(face)[:, None, None], shape).ravel().astype(np.int32),
        np.broadcast_to(distances[None, :, None], shape).ravel(),
        np.broadcast_to(angles, shape).ravel(),
    )


def standing_at(T_object_scanner: Floats, aim: Floats, face: NDArray[np.integer]) -> Viewpoints:
    """Viewpoints of given poses.

    Args:
        T_object_scanner: (N, 4, 4) poses of the scanner [m].
        aim: (N, 3) points that they are aimed at [m], object frame; the standoff is the distance to them.
        face: (N,) planning face of each point, -1 for none.
    """
    R = T_object_scanner[:, :3, :3]
    level = _look_along(R[:, :, 2])
    along, across = (np.einsum("ni,ni->n", level[:, :, axis], R[:, :, 0]) for axis in (0, 1))
    return Viewpoints(
        T_object_scanner[:, None],
        np.asarray(face, dtype=np.int32),
        np.linalg.norm(aim - T_object_scanner[:, :3, 3], axis=1),
        np.arctan2(across, along) % (2 * np.pi),
    )


def enclosing_radius(mesh: TriangleMesh, centre: ArrayLike) -> float:
    """Radius [m] of the smallest sphere about `centre` ((3,) [m], object frame) that holds every vertex."""
    return float(np.linalg.norm(mesh.vertices - readonly("centre", centre, (3,)), axis=1).max())


def join_viewpoints(parts: Sequence[Viewpoints]) -> Viewpoints:
    """All viewpoints in the order of the parts; every part has as many poses per viewpoint as the first."""
    return Viewpoints(
        np.concatenate([part.T_object_scanner for part in parts]),
        np.concatenate([part.face for part in parts]),
        np.concatenate([part.standoff for part in parts]),
        np.concatenate([part.roll for part in parts]),
    )


def pick_viewpoints(viewpoints: Viewpoints, which: NDArray[np.integer] | Bools) -> Viewpoints:
    """Some viewpoints: (n,) rows in the order that is wanted, or (V,) bool."""
    return Viewpoints(
        viewpoints.T_object_scanner[which], viewpoints.face[which], viewpoints.standoff[which], viewpoints.roll[which]
    )


def rotations(vectors: Floats) -> Floats:
    """(n, 3, 3) rotations about vectors (n, 3) by their lengths [rad] (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.where(angle > 0, angle, 1.0)[:, None]
    K = np.zeros((len(vectors), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    K -= K.transpose(0, 2, 1)
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * K + (1.0 - cosine) * (K @ K))


def _look_along(directions: Floats) -> Floats:
    """(N, 3, 3) rotations R_object_scanner of roll 0 for unit viewing directions (N, 3)."""
    towards_z = np.array([0.0, 0.0, 1.0]) - directions[:, 2:] * directions
    towards_x = np.array([1.0, 0.0, 0.0]) - directions[:, :1] * directions
    along_z = np.hypot(directions[:, 0], directions[:, 1]) < _ALONG_Z
    baseline = np.where(along_z[:, None], towards_x, towards_z)
    baseline /= np.linalg.norm(baseline, axis=1, keepdims=True)
    # Once more at right angles: near the z axis the first subtraction cancels digits.
    baseline -= np.einsum("nj,nj->n", baseline, directions)[:, None] * directions
    baseline /= np.linalg.norm(baseline, axis=1, keepdims=True)
    return np.stack([baseline, np.cross(directions, baseline), directions], axis=2)


def _positive(name: str, values: Sequence[float]) -> Floats:
    """The values as (n,) array; every one a finite length above zero [m]."""
    lengths = readonly(name, values, (None,))
    if not len(lengths):
        raise PlannerError(f"{name} is empty; give at least one length in metres")
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise PlannerError(f"{name} contains {float(lengths.min()):g} m; every length must be above 0 and finite")
    return lengths


def _angles(rolls: Sequence[float]) -> Floats:
    """The rolls as (n,) array of finite angles [rad]."""
    angles = readonly("rolls", rolls, (None,))
    if not len(angles) or not np.isfinite(angles).all():
        raise PlannerError("rolls must hold at least one finite angle in radians")
    return angles
