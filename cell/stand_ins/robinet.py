"""Robinet: a tap, all holes and cavities (genus 5: a bore with three mouths, a wheel with three spokes). z is up."""

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
    ripples,
    rotation,
    torus,
    tube,
    union,
    without,
)


def field(rng: np.random.Generator) -> Field:
    """The tap in its box of 228 x 120 x 108 mm: inlet at -x, spout at +x, side inlet at +y, wheel on top."""
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
    """The wheel with its spokes, hub and stem."""
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
    """Grip scallops around the wheel's rim, 1.2 mm deep."""
    angle = np.arctan2(p[1], p[0] - np.float32(x))
    radius = np.sqrt(p[1] ** 2 + (p[0] - np.float32(x)) ** 2)
    value: Values = (0.6 * np.cos(angle * 18) * np.clip((radius - 46) / 4, 0, 1) - 0.3).astype(np.float32)
    return value


def _hexagon(centre: tuple[float, float, float], across: float, half_length: float) -> Field:
    """A nut about the x axis: three boxes' intersection."""
    faces = [box(centre, (half_length, across, 200), 0.5, rotation(0, angle)) for angle in (0, 60, 120)]

    def field(p: Points) -> Values:
        value = faces[0](p)
        for face in faces[1:]:
            value = np.maximum(value, face(p))
        return value

    return field
