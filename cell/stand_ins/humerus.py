"""Humerus: an upper arm bone (genus 0). x runs along the shaft from the shoulder's head to the elbow's condyles."""

import numpy as np

from cell.stand_ins.fields import Field, capsule, displaced, ellipsoid, ripples, rotation, tube, union, without


def field(rng: np.random.Generator) -> Field:
    """The bone in its box of 60 x 11 x 9 mm."""
    shaft = tube(
        [(-25, 0.2, 0.2), (-20, 0.0, 0.0), (-12, -0.2, -0.2), (0, 0.1, 0.1), (12, 0.1, 0.3), (20, 0, 0.1), (25, 0, 0)],
        [2.9, 2.4, 1.95, 1.7, 1.6, 1.75, 2.0],
        0.8,
    )
    head = ellipsoid((-25.6, 1.5, 0.3), (4.3, 3.9, 4.2), rotation(2, -30))
    greater = ellipsoid((-26.2, -2.7, 0.2), (3.0, 2.5, 3.4))
    lesser = ellipsoid((-23.8, -0.8, 3.3), (2.4, 1.3, 1.2))
    groove = capsule((-29.5, -1.4, 3.4), (-18, -1.6, 3.0), 0.85)
    tuberosity = ellipsoid((-6, -1.7, 0.6), (7.0, 0.9, 1.0))
    blade = ellipsoid((24.4, 0, 0), (4.6, 4.3, 1.6))
    medial = ellipsoid((25.6, 4.1, -0.3), (1.6, 1.2, 1.1))
    lateral = ellipsoid((25.4, -3.9, 0.0), (1.8, 1.0, 1.1))
    trochlea = union(
        1.0,
        ellipsoid((27.6, 2.5, 0), (2.4, 1.0, 2.5)),
        ellipsoid((27.6, 0.0, 0), (2.1, 1.0, 2.2)),
        capsule((27.6, -1.5, 0), (27.6, 2.8, 0), 1.6),
    )
    capitulum = ellipsoid((27.4, -2.2, 0.5), (2.3, 1.7, 2.2))
    olecranon = ellipsoid((23.6, 0.6, -2.4), (1.7, 1.4, 1.5))
    coronoid = ellipsoid((24.0, 0.7, 2.3), (1.2, 1.2, 1.0))
    bone = union(2.2, shaft, blade, greater, tuberosity)
    bone = union(1.2, bone, head, lesser, medial, lateral)
    bone = union(0.7, bone, trochlea, capitulum)
    bone = without(1.2, bone, groove, olecranon, coronoid)
    bone = displaced(bone, ripples(rng, 0.08, 9.0))
    return displaced(bone, ripples(rng, 0.02, 1.6, 8))
