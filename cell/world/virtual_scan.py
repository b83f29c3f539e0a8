"""Virtual scan: the ray grid of a scanner traced on part and occluders (Section 3.6 of the paper, Figure 5).

Active ray: from the source to its first hit on part or occluders. Reflected ray: from the hit to the sensor; an object
in it causes the paper's shadow effect. Each ray has the code of the first condition that it fails. Object frame,
metres.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from planner.geometry.mesh import TriangleMesh
from planner.ports import RayCaster, Rejection, Scanner
from planner.values import Floats, Value, freeze
from planner.viewpoints.lines_of_sight import flatten_poses, lift_points


@dataclass(frozen=True, slots=True, eq=False)
class Scan(Value):
    """Result of one scan.

    Attributes:
        T_object_scanner: pose of the scanner [m].
        grid_shape: (n_v, n_h); ray (i, j) has number i * n_h + j.
        codes: `Rejection` of every ray; MEASURED for those with a point.
        hit_face: first face of the part that the ray meets, -1 for none or an occluder before it.
        pixel: number of the ray of each point, ascending.
        points: [m], object frame.
        face: face of the part that each point lies on.
    """

    T_object_scanner: Annotated[Floats, "4 4"]
    grid_shape: tuple[int, int]
    codes: Annotated[NDArray[np.uint8], "rays"]
    hit_face: Annotated[NDArray[np.int32], "rays"]
    pixel: Annotated[NDArray[np.int32], "P"]
    points: Annotated[Floats, "P 3"]
    face: Annotated[NDArray[np.int32], "P"]

    def __post_init__(self) -> None:
        freeze(self, rays=self.grid_shape[0] * self.grid_shape[1])

    def sigma(self, scanner: Scanner, part_mesh: TriangleMesh) -> Floats:
        """Return the expected standard deviation (P,) of each point along its ray [m], by the scanner's model.

        A point at exactly 90 degrees to the sensor has no finite one and gets the largest of the others.

        Args:
            scanner: scanner of this scan.
            part_mesh: the part, object frame.

        Raises:
            SceneError: if the scanner has no model of sigma, or no finite sigma for any point (baseline 0).
        """
        law = getattr(scanner, "sigma", None)
        if not callable(law):
            raise SceneError(
                f"the scanner {type(scanner).__name__} has no model of the precision of its points; give --range-noise"
            )
        R, t = self.T_object_scanner[:3, :3], self.T_object_scanner[:3, 3]
        sigma: Floats = law((self.points - t) @ R, part_mesh.normals[self.face] @ R)
        known = np.isfinite(sigma)
        if len(sigma) and not known.any():
            raise SceneError(
                "the scanner's model gives no point a finite standard deviation (a baseline of 0 triangulates nothing)"
                "; give --range-noise instead of --noise model"
            )
        return np.where(known, sigma, sigma[known].max(initial=0.0))

    def counts(self) -> dict[Rejection, int]:
        """Count the rays of each code."""
        numbers = np.bincount(self.codes, minlength=len(Rejection))
        return {reason: int(numbers[reason]) for reason in Rejection}


def scan(
    scanner: Scanner,
    T_object_scanner: Floats,
    part_caster: RayCaster,
    part_mesh: TriangleMesh,
    occluder_caster: RayCaster | None = None,
) -> Scan:
    """Scan the part from one pose.

    A ray that meets an occluder before the part is SOURCE_BLOCKED, even if the part is not behind it. `scanner.reject`
    checks range, field of view and grazing angles at the hit, with the normal of the hit face: a face seen from behind
    is rejected as grazing.

    Args:
        scanner: sensor model and ray grid.
        T_object_scanner: (4, 4) pose [m].
        part_caster: casts rays on `part_mesh`.
        part_mesh: the part, object frame.
        occluder_caster: casts rays on all occluders, object frame.
    """
    pose = flatten_poses(np.asarray(T_object_scanner)[None, None])[0]
    R, t = pose[:3, :3], pose[:3, 3]
    grid = scanner.ray_directions()
    directions = grid @ R.T
    sources = np.broadcast_to(R @ scanner.source + t, directions.shape)
    hits = part_caster.first_hit(sources, directions)
    codes = np.where(hits.face >= 0, np.uint8(Rejection.MEASURED), np.uint8(Rejection.NO_HIT))
    hit_face = hits.face.copy()
    if occluder_caster is not None:
        in_front = occluder_caster.first_hit(sources, directions)
        hidden = (in_front.face >= 0) & (in_front.distance < hits.distance)
        codes[hidden] = Rejection.SOURCE_BLOCKED
        hit_face[hidden] = -1

    pixel = np.flatnonzero(codes == Rejection.MEASURED)
    distance = hits.distance[pixel, None]
    normals = part_mesh.normals[hits.face[pixel]]
    codes[pixel] = scanner.reject(scanner.source + grid[pixel] * distance, normals @ R)

    is_measured = codes[pixel] == Rejection.MEASURED
    pixel, normals, distance = pixel[is_measured], normals[is_measured], distance[is_measured]
    points = sources[pixel] + directions[pixel] * distance
    ends = lift_points(points, normals, part_mesh.diagonal)
    sensors = np.broadcast_to(R @ scanner.sensor + t, ends.shape)
    blocked = part_caster.blocked(sensors, ends)
    if occluder_caster is not None:
        blocked |= occluder_caster.blocked(sensors, ends)
    codes[pixel[blocked]] = Rejection.SENSOR_BLOCKED
    pixel, points = pixel[~blocked], points[~blocked]
    return Scan(pose, scanner.grid_shape, codes, hit_face, pixel, points, hit_face[pixel])
