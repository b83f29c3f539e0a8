"""Contact of the part with its supports: surface that is covered in one set-up and free in another."""

from collections.abc import Sequence

import numpy as np

from cell.world.occluders import Occluder, make_caster
from cell.world.solids import FLUSH
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.values import Bools

CONTACT = 1e-3
"""Distance below which a support covers the surface [m]: no line of sight passes, and no part is placed better."""


def in_contact(samples: SurfaceSamples, supports: Sequence[Occluder]) -> Bools:
    """Return (S,) whether the normal of each sample meets a support within `CONTACT`.

    A support is met from outside: the upper side of a thin sheet does not touch the support of its lower side. Part and
    support may be `FLUSH` deep in each other, as in every feasible scene.

    Args:
        samples: of the part.
        supports: post, floor, pedestal and fixtures, object frame.
    """
    outward = np.concatenate([TriangleMesh(piece.vertices, piece.faces).normals for piece in supports])
    hits = make_caster(supports).first_hit(samples.points - 2 * FLUSH * samples.normals, samples.normals)
    faces = np.einsum("ij,ij->i", outward[hits.face], samples.normals) < 0
    contact: Bools = (hits.face >= 0) & (hits.distance <= CONTACT + 2 * FLUSH) & faces
    return contact
