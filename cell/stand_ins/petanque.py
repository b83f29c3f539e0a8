"""Joueur de petanque: a player in a long step who swings a boule (genus 0). y is up, he throws towards +x."""

import numpy as np

from cell.stand_ins.fields import (
    Field,
    Points,
    Values,
    box,
    capsule,
    displaced,
    ellipsoid,
    ripples,
    rotation,
    torus,
    tube,
    union,
)


def field(rng: np.random.Generator) -> Field:
    """The figure in its box of 207 x 179 x 74 mm, about the origin."""
    chest, head = (6, 42, 0), (24, 73, 0)
    trunk = union(
        14,
        ellipsoid((-13, 2, 0), (21, 19, 24)),
        ellipsoid((-6, 20, 0), (22, 24, 23), rotation(2, 25)),
        ellipsoid(chest, (22, 24, 25), rotation(2, 28)),
        capsule((8, 54, -18), (8, 54, 18), 12),
    )
    belly = ellipsoid((6, 18, 0), (18, 16, 18))
    neck = capsule((12, 56, 0), (20, 66, 0), 9.5)
    face = union(
        3,
        ellipsoid(head, (14, 15, 12.5)),
        ellipsoid((37.5, 71, 0), (5, 3.2, 2.8)),  # nose
        ellipsoid((32, 61.5, 0), (6.5, 5, 7.5)),  # chin
        capsule((34, 66, -5), (34, 66, 5), 3.0),  # moustache
        ellipsoid((22, 71, 12.5), (3, 4.5, 2)),
        ellipsoid((22, 71, -12.5), (3, 4.5, 2)),
    )
    cap = union(
        2,
        ellipsoid((22, 83, 0), (18, 7, 17), rotation(2, 8)),
        ellipsoid((37, 80, 0), (13, 2.8, 12), rotation(2, 6)),  # the peak
    )
    front_leg = tube([(-8, -2, 12), (36, -26, 18), (32, -74, 19)], [19.5, 15.0, 10.0], 4)
    front_foot = union(4, ellipsoid((31, -80, 19), (11, 8.5, 9)), ellipsoid((45, -83, 20), (17, 6.5, 10)))
    back_leg = tube([(-20, -3, -12), (-44, -36, -18), (-80, -64, -18)], [19.5, 15.0, 10.0], 4)
    back_foot = union(
        4, ellipsoid((-86, -70, -18), (11, 8, 9)), ellipsoid((-82, -80, -19), (11, 7.5, 9), rotation(2, 60))
    )
    arm = tube([(10, 52, 20), (46, 30, 26), (86, 42, 23)], [12.5, 10.5, 7.5], 3)
    hand = union(3, ellipsoid((92, 45, 23), (9, 6, 8)), capsule((96, 42, 27), (105, 41, 27), 3.4))
    boule = ellipsoid((98, 56, 22), (13, 13, 13))
    other_arm = tube([(6, 51, -20), (-32, 36, -26), (-70, 50, -25)], [12.5, 10.5, 7.5], 3)
    other_hand = union(2.5, ellipsoid((-79, 53, -25), (10, 6.5, 7)), *_fingers())
    belt = torus((0, 0, 0), 1, 22.5, 2.0, 1.6)
    shift, tilt = np.array([[-11.0], [7.0], [0]], np.float32), rotation(2, 12)

    def tilted_belt(p: Points) -> Values:
        return belt((tilt @ (p - shift)).astype(np.float32, copy=False))

    pocket = box((-33, -4, -10), (3, 7, 6), 1.5)
    body = union(8, trunk, front_leg, back_leg)
    body = union(6, body, belly, arm, other_arm, neck)
    body = union(3, body, face, front_foot, back_foot, hand, other_hand)
    body = union(1.2, body, cap, tilted_belt, pocket)
    return union(1.2, displaced(body, ripples(rng, 0.8, 15.0, 8)), boule)


def _fingers() -> list[Field]:
    return [capsule((-84, 55, -25 + 4.0 * i), (-96, 59 - i * i, -25 + 5.6 * i), 3.0, 2.2) for i in (-1, 0, 1)]
