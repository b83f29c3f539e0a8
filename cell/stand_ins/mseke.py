"""Mseke: a carved head without deep cavities (genus 0). z is up, the face looks along -y."""

import numpy as np

from cell.stand_ins.fields import (
    Field,
    Points,
    Values,
    box,
    capsule,
    displaced,
    ellipsoid,
    mirrored,
    ripples,
    rotation,
    torus,
    tube,
    union,
    without,
)


def field(rng: np.random.Generator) -> Field:
    """The head in its box of 188 x 223 x 183 mm, about the origin."""
    skull = ellipsoid((0, 16, 16), (80, 92, 76))
    bun = ellipsoid((0, 84, 30), (44, 26, 38))
    jaw = ellipsoid((0, -34, -40), (56, 52, 50))
    neck = capsule((0, 12, -50), (0, 14, -110), 52, 60)
    head = union(26, skull, jaw, neck)
    head = union(14, head, bun)
    head = displaced(head, _braids)

    cheek = ellipsoid((40, -46, -8), (25, 20, 20))
    brow = tube([(4, -80, 25), (24, -81, 33), (52, -62, 27)], [6, 7, 5])
    socket = ellipsoid((28, -88, 12), (19, 13, 11), rotation(1, 8))
    lid = ellipsoid((28, -74.5, 11), (16, 9.5, 7.5), rotation(1, 8))
    ear = union(
        3,
        ellipsoid((81, 14, 4), (10, 19, 27), rotation(0, 15)),
        torus((87, 12, 6), 0, 17, 5),
        ellipsoid((84, 6, -22), (8, 9, 11)),
    )
    half = mirrored(0, union(4, cheek, brow, ear))

    nose = union(
        5,
        capsule((0, -80, 22), (0, -96, -12), 8, 12),
        capsule((0, -80, -14), (0, -96, -13), 12, 10),
        mirrored(0, ellipsoid((12, -86, -16), (9, 13, 8.5))),
    )
    lips = union(
        1.5,
        tube([(-25, -72, -42), (-10, -85, -38), (0, -86, -39.5), (10, -85, -38), (25, -72, -42)], [3, 7, 6.5, 7, 3], 2),
        tube([(-25, -72, -43), (-10, -83, -51), (0, -85, -52), (10, -83, -51), (25, -72, -43)], [3, 7, 7.5, 7, 3], 2),
    )
    chin = ellipsoid((0, -68, -74), (22, 18, 14))
    head = union(9, head, half)
    head = without(7, head, mirrored(0, socket))
    head = union(3, head, mirrored(0, lid))
    head = union(7, head, nose, chin)
    head = union(4, head, lips)
    head = displaced(head, ripples(rng, 0.5, 30.0, 8))
    return without(3, head, box((0, 0, -138), (200, 200, 50)))  # sawn off flat below the neck


def _braids(p: Points) -> Values:
    """Rows of plaited hair, 2.4 mm high, above a hairline that rises towards the face."""
    x, y, z = p
    above = z - (38 - np.float32(0.45) * (y + 20))
    hair = np.clip(above / 8, 0, 1) * np.clip((y + 66) / 6, 0, 1)
    row = np.arctan2(x, z + 40) * 18
    value: Values = (hair * (1.2 + 1.2 * np.cos(row) + 0.5 * np.cos(y * np.float32(0.75)))).astype(np.float32)
    return value
