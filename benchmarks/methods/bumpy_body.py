"""Body for the stability maps of rays and surfaces: bumpy, closed, with a deep dent, and quickly computed."""

from functools import lru_cache

import numpy as np
import trimesh

from cell.part import workpiece
from cell.part.workpiece import Workpiece

_RADIUS_M = 0.1


@lru_cache(maxsize=2)
def body(subdivisions: int = 6) -> Workpiece:
    """Return the body, about 0.25 m long, its middle near the origin.

    Each subdivision has four times the faces (6: 81,920).
    """
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    x, y, z = np.asarray(ball.vertices).T
    radius = 1.0 + 0.12 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.08 * np.sin(5 * z)
    radius -= 0.5 * np.exp(-9 * ((x - 0.9) ** 2 + y**2 + (z - 0.3) ** 2))  # a dent in which views shade each other
    vertices = _RADIUS_M * radius[:, None] * np.asarray(ball.vertices) * (1.3, 1.0, 0.8)
    return workpiece.from_mesh("body", vertices, np.asarray(ball.faces, dtype=np.int64), "m", "")
