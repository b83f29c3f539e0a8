"""The shapes of the built-in parts as implicit functions, each in the box of the paper's model [mm]."""

import numpy as np

from benchmarks.part_models.fields import (
    Field,
    Points,
    Values,
    box,
    capsule,
    cylinder,
    displaced,
    ellipsoid,
    mirrored,
    revolve,
    ripples,
    rotation,
    torus,
    tube,
    union,
    without,
)


def mseke(rng: np.random.Generator) -> Field:
    """Return a carved head without deep cavities (genus 0), 188 x 223 x 183 mm; z is up, the face looks along -y."""
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
    """Return rows of plaited hair, 2.4 mm high, above a hairline that rises towards the face."""
    x, y, z = p
    above = z - (38 - np.float32(0.45) * (y + 20))
    hair = np.clip(above / 8, 0, 1) * np.clip((y + 66) / 6, 0, 1)
    row = np.arctan2(x, z + 40) * 18
    value: Values = (hair * (1.2 + 1.2 * np.cos(row) + 0.5 * np.cos(y * np.float32(0.75)))).astype(np.float32)
    return value


def mug(rng: np.random.Generator) -> Field:
    """Return a mug: deep cavity and handle (genus 1), 60 x 50 x 47 mm; its axis is z, the handle points to +x."""
    along = [0.0, 1.0, 4.0, 12.0, 24.0, 38.0, 47.0]
    outside = revolve(2, along, [21.0, 22.6, 23.8, 24.6, 25.0, 24.6, 24.2])
    angle = np.linspace(-np.pi / 2, np.pi / 2, 15)
    loop = [(23.0 + 9.2 * np.cos(t), 0.0, 24.5 + 13.5 * np.sin(t)) for t in angle]
    radii = 2.35 + 0.9 * np.abs(np.sin(angle)) ** 6  # the handle grows thicker where it meets the wall
    handle = tube(loop, list(radii), blend=0.4)
    cavity = union(2.0, cylinder((0, 0, 4.0), (0, 0, 60.0), 21.6, 4.0), cylinder((0, 0, 44.5), (0, 0, 62.0), 22.0, 1.0))
    foot = cylinder((0, 0, -5.0), (0, 0, 1.2), 18.0, 0.5)
    body = union(1.5, outside, handle)
    return displaced(without(1.2, body, cavity, foot), ripples(rng, 0.06, 14.0))


def robinet(rng: np.random.Generator) -> Field:
    """Return a tap (genus 5: a bore with three mouths, a wheel with three spokes), 228 x 120 x 108 mm.

    z is up; inlet at -x, spout at +x, side inlet at +y, wheel on top.
    """
    stem_x = -42.0
    arc = np.linspace(0, np.pi / 2, 8)
    spout = [
        (20.0, 0.0, -8.0),
        (66.0, 0.0, -8.0),
        *((66 + 31 * np.sin(t), 0.0, -39 + 31 * np.cos(t)) for t in arc[1:]),
        (97.0, 0.0, -47.0),
    ]
    outside = union(
        6,
        cylinder((-112, 0, -8), (30, 0, -8), 14, 1),
        ellipsoid((stem_x, 0, -6), (32, 24, 24)),
        cylinder((stem_x, 0, -8), (stem_x, 57, -8), 12.5, 1),
        cylinder((stem_x, 0, 0), (stem_x, 0, 30), 12, 2),
        tube(spout, [13.0, 12.5] + [12.0] * 7 + [12.5], 2),
    )
    flanges = union(
        1.5,
        cylinder((-114, 0, -8), (-105, 0, -8), 27, 1.5),
        cylinder((stem_x, 52, -8), (stem_x, 60, -8), 23, 1.5),
        cylinder((97, 0, -54), (97, 0, -43), 17, 1.5),
        _hexagon((30, 0, -8), 18, 7),
        cylinder((stem_x, 0, 26), (stem_x, 0, 33), 15, 1),
    )
    bore = union(
        3,
        cylinder((-130, 0, -8), (66, 0, -8), 9, 0),
        cylinder((stem_x, 0, -8), (stem_x, 80, -8), 8, 0),
        tube([*spout[1:-1], (97.0, 0.0, -80.0)], [8.5] * (len(spout) - 1), 1),
        ellipsoid((stem_x, 0, -7), (22, 16, 15)),  # the chamber is wider than its mouths
    )
    pockets = union(
        0,
        *(
            cylinder((-130, 20 * np.cos(a), -8 + 20 * np.sin(a)), (-109, 20 * np.cos(a), -8 + 20 * np.sin(a)), 3)
            for a in _ring(6)
        ),
        *(
            cylinder(
                (stem_x + 16 * np.cos(a), 80, -8 + 16 * np.sin(a)),
                (stem_x + 16 * np.cos(a), 55, -8 + 16 * np.sin(a)),
                2.5,
            )
            for a in _ring(6)
        ),
        cylinder((stem_x, 0, 50.5), (stem_x, 0, 70), 5, 0.5),
    )
    grooves = union(0, *(torus((x, 0, -8), 0, 14.5, 1.8) for x in (-96.0, -90.0, -84.0)))
    knurl = displaced(_wheel(stem_x), lambda p: _knurl(p, stem_x))
    body = union(1.5, outside, flanges)
    body = without(1.2, union(1.5, body, knurl), bore, pockets, grooves)
    return displaced(body, ripples(rng, 0.12, 25.0))


def _ring(n: int) -> list[float]:
    return [2 * np.pi * (i + 0.5) / n for i in range(n)]


def _wheel(x: float) -> Field:
    """Return the wheel with its spokes, hub and stem."""
    return union(
        3,
        torus((x, 0, 47), 2, 54.3, 5.5),
        *(
            capsule((x, 0, 44), (x + 53 * np.cos(a), 53 * np.sin(a), 47), 5.5, 4.0)
            for a in np.arange(3) * 2 * np.pi / 3 + 0.3
        ),
        cylinder((x, 0, 37), (x, 0, 54), 12, 2),
        cylinder((x, 0, 20), (x, 0, 42), 8.5, 1),
    )


def _knurl(p: Points, x: float) -> Values:
    """Return the height of grip scallops around the rim of the wheel, 1.2 mm deep."""
    angle = np.arctan2(p[1], p[0] - np.float32(x))
    radius = np.sqrt(p[1] ** 2 + (p[0] - np.float32(x)) ** 2)
    value: Values = (0.6 * np.cos(angle * 18) * np.clip((radius - 46) / 4, 0, 1) - 0.3).astype(np.float32)
    return value


def _hexagon(centre: tuple[float, float, float], across: float, half_length: float) -> Field:
    """Return a nut about the x axis: the intersection of three boxes."""
    faces = [box(centre, (half_length, across, 200), 0.5, rotation(0, angle)) for angle in (0, 60, 120)]

    def field(p: Points) -> Values:
        value = faces[0](p)
        for face in faces[1:]:
            value = np.maximum(value, face(p))
        return value

    return field


def petanque(rng: np.random.Generator) -> Field:
    """Return a player in a long step who swings a boule (genus 0), 207 x 179 x 74 mm; y is up, he throws towards +x."""
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


def humerus(rng: np.random.Generator) -> Field:
    """Return an upper arm bone (genus 0), 60 x 11 x 9 mm; x runs from the shoulder's head to the elbow's condyles."""
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


def st_jean(rng: np.random.Generator) -> Field:
    """A robed statue with staff and cross, one arm akimbo (genus 2), 73 x 158 x 46 mm; y is up, it looks along +z."""
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
    """Return hanging folds of the robe: deeper towards the hem, wandering with the height."""
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
