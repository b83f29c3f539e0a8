"""What the part touches where it lies: surface that its support covers in one set-up and that is free in another."""

from collections.abc import Sequence

import numpy as np

from cell.world.occluders import Occluder, make_caster
from cell.world.solids import FLUSH
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.values import Bools

CONTACT = 1e-3
"""Nearer than this a support covers the surface [m]: no leg gets between, and no part is set down better."""


def touching(samples: SurfaceSamples, supports: Sequence[Occluder]) -> Bools:
    """(S,) samples whose normal meets a support within `CONTACT`.

    A support is met from outside alone: the upper side of a thin sheet does not touch what its lower side lies on. Part
    and support may stand `FLUSH` deep in each other, as in every scene that can be.

    Args:
        samples: of the part.
        supports: post, floor, pedestal and fixtures, object frame.
    """
    outward = np.concatenate([TriangleMesh(piece.vertices, piece.faces).normals for piece in supports])
    hits = make_caster(supports).first_hit(samples.points - 2 * FLUSH * samples.normals, samples.normals)
    faces = np.einsum("ij,ij->i", outward[hits.face], samples.normals) < 0
    touched: Bools = (hits.face >= 0) & (hits.distance <= CONTACT + 2 * FLUSH) & faces
    return touched
