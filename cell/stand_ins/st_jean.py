"""St Jean Baptiste: a robed statue with staff and cross, one arm akimbo (genus 2). y is up, he looks along +z."""

import numpy as np

from cell.stand_ins.fields import (
    Field,
    Points,
    Values,
    box,
    capsule,
    cylinder,
    displaced,
    ellipsoid,
    mirrored,
    ripples,
    tube,
    union,
    without,
)


def field(rng: np.random.Generator) -> Field:
    """The statue in its box of 73 x 158 x 46 mm; y from 0 (under the plinth) to 158."""
    plinth = union(
        1,
        cylinder((0, 0, 0), (0, 7, 0), 22.5, 1.2),
        box((-1, 3.5, 0), (34, 3.5, 17), 2),
        cylinder((0, 6, 0), (0, 10, 0), 19, 1.5),
    )
    robe = union(
        9,
        capsule((0, 18, 0), (0, 64, 0), 18.0, 14.0),
        ellipsoid((1, 92, 0), (16.0, 26, 12.5)),
        ellipsoid((0, 70, 0), (14, 18, 12.5)),
        capsule((-12, 109, 0), (12, 109, 0), 8.0),
    )
    robe = displaced(robe, _folds)
    cloak = displaced(tube([(13, 110, -2), (8, 88, 11), (-6, 66, 13.5), (-16, 44, 8)], [4.5, 5, 5.5, 5], 2), _folds)
    neck = capsule((0, 112, 0), (0, 124, 1), 4.6)
    head = union(
        2.5,
        ellipsoid((0, 131.5, 1), (8.2, 10.5, 9.0)),
        ellipsoid((0, 130.5, 10), (1.6, 3.2, 2.4)),
        mirrored(0, ellipsoid((3.4, 133.8, 8.2), (2.8, 1.1, 1.4))),
        ellipsoid((0, 121.5, 5), (5.2, 6.5, 5.0)),  # the beard
    )
    hair = displaced(
        union(
            4,
            ellipsoid((0, 134, -2), (9.6, 9.6, 9.2)),
            mirrored(0, capsule((7.8, 131, -2), (8.0, 117, -3), 3.6, 2.6)),
            ellipsoid((0, 122, -6), (8, 9, 4)),
        ),
        _curls,
    )
    eyes = mirrored(0, ellipsoid((3.4, 131.8, 9.4), (1.9, 1.1, 1.2)))
    right_arm = tube([(-14, 108, 0), (-27, 91, 2), (-31, 107, 6)], [6.4, 4.6, 4.0], 2)
    right_hand = ellipsoid((-31.5, 109, 6), (3.6, 4.6, 3.8))
    staff = union(
        0.6,
        capsule((-31, 5, 6), (-31.5, 155.2, 5), 1.9),
        capsule((-24, 144, 5), (-38, 144, 5), 1.8),
        ellipsoid((-31.5, 155.5, 5), (2.4, 2.4, 2.4)),
    )
    left_arm = tube([(14, 108, 0), (32.0, 88, -3), (14, 71, 8)], [6.6, 5.4, 4.2], 2)
    left_hand = ellipsoid((11, 72, 11.5), (4.8, 3.6, 3.6))
    feet = mirrored(0, ellipsoid((6.5, 11, 15), (4.2, 3, 7)))
    lamb = union(2, displaced(ellipsoid((23, 12, 0), (9, 8.5, 12)), _curls), ellipsoid((24, 20, 11), (4.6, 5.6, 6)))
    figure = union(3, robe, left_arm, right_arm, neck)
    figure = union(1.5, figure, cloak, head, left_hand, right_hand, feet)
    figure = without(1, figure, eyes)
    figure = union(0.8, figure, hair, plinth, staff, lamb)
    return displaced(figure, ripples(rng, 0.12, 6.0, 8))


def _folds(p: Points) -> Values:
    """Hanging folds of the robe: deeper towards the hem, wandering with the height."""
    x, y, z = p
    angle = np.arctan2(x, z)
    depth = np.clip((120 - y) / 70, 0, 1) * np.clip((y - 8) / 6, 0, 1)
    wave = np.sin(angle * 9 + 0.05 * y + 1.1 * np.sin(0.045 * y)) + 0.5 * np.sin(angle * 17 - 0.09 * y)
    value: Values = (1.5 * depth * wave).astype(np.float32)
    return value


def _curls(p: Points) -> Values:
    x, y, z = p
    value: Values = (0.55 * np.sin(1.15 * x + 0.4 * y) * np.sin(1.1 * y + 0.5 * z) * np.sin(1.2 * z - 0.3 * x)).astype(
        np.float32
    )
    return value
