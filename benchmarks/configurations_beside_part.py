"""Configurations of the arm near a part, at which only the part can collide.

Joint solutions of candidate viewpoints (those that `reach` checks) and of random scanner poses close to the surface,
tilted and turned. Hull, pieces and triangles differ at these configurations. Base frame, metres, radians.
"""

import numpy as np

from cell.part.workpiece import Workpiece
from cell.robot.arm import kinematics_of
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from planner.values import Floats

_APART_M = 50.0  # place of the part at which only the rest of the cell can collide
_TILT = 0.4  # tilt of the viewing axis from the normal, one sigma per component
_NEAREST, _LEAST_FARTHEST = 0.005, 0.08  # source to surface [m]
_SOLUTIONS = 6  # trials for each requested configuration


def configurations(
    world: World, part: Workpiece, T_object_scanner: Floats, standoff: float, counts: tuple[int, int],
    rng: np.random.Generator,
) -> Floats:  # fmt: skip
    """Return (N, 6) configurations [rad] within limits and without collision except with the part.

    Args:
        world: the compiled cell.
        part: the part in the cell.
        T_object_scanner: (V, 4, 4) candidate poses [m].
        standoff: standoff of the candidates [m], the largest distance of random poses from the surface.
        counts: largest numbers of configurations of candidates and of random poses.
        rng: draws faces, tilts and distances, and the order of the solutions.
    """
    apart = np.eye(4)
    apart[:3, 3] = 0.0, 0.0, _APART_M
    elsewhere = MujocoCollisionChecker(world, apart)
    kinematics = kinematics_of(world.model)

    def solutions(T: Floats, count: int) -> Floats:
        T_base_flange = world.T_base_object @ T @ np.linalg.inv(world.T_flange_scanner)
        q = kinematics.inverse(T_base_flange).reshape(-1, 6)
        q = q[np.isfinite(q).all(axis=1)]
        q = q[((q >= world.limits.lower) & (q <= world.limits.upper)).all(axis=1)]
        q = q[rng.permutation(len(q))[: _SOLUTIONS * count]]
        return np.asarray(q[elsewhere.free(q)][:count])

    faces = rng.integers(len(part.reference.faces), size=4 * counts[1])
    normals = part.reference.normals[faces]
    near = np.tile(np.eye(4), (len(faces), 1, 1))
    for k, normal in enumerate(normals):
        tilted = normal + _TILT * rng.normal(size=3)
        z = -tilted / np.linalg.norm(tilted)
        x = np.cross(rng.normal(size=3), z)
        x /= np.linalg.norm(x)
        near[k, :3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        corner = part.reference.vertices[part.reference.faces[faces[k], 0]]
        near[k, :3, 3] = corner - z * rng.uniform(_NEAREST, max(_LEAST_FARTHEST, standoff))
    return np.concatenate([solutions(T_object_scanner, counts[0]), solutions(near, counts[1])])
