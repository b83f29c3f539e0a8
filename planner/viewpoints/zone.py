"""The optimal scanning zone: a viewpoint in front of every planning face (Section 3.4.2)."""

from collections.abc import Sequence

import numpy as np

from planner.surface.mesh import TriangleMesh
from planner.viewpoints.viewpoints import Viewpoints, looking_at


def optimal_scanning_zone(planning: TriangleMesh, standoffs: Sequence[float], rolls: Sequence[float]) -> Viewpoints:
    """One viewpoint per planning face, standoff and roll, in this order (the last changes fastest).

    The source stands at the standoff from the face's centre along its normal and looks against the normal. A face
    without area has no normal and gives no viewpoint.

    Args:
        planning: the decimated mesh, object frame.
        standoffs: distances from the face's centre [m], > 0.
        rolls: angles about the viewing axis [rad].

    Raises:
        PlannerError: if a standoff is not positive, or there is no standoff or no roll.
    """
    face = np.flatnonzero(planning.areas > 0)
    return looking_at(planning.centres[face], planning.normals[face], face, standoffs, rolls)
