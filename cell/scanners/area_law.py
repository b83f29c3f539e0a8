"""Conditions of `laser-area` that need no ray cast, compiled: import this module only where it is used."""

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.ports import Rejection
from planner.values import Floats, Ints

_MEASURED, _OUT_OF_FOV, _OUT_OF_RANGE = int(Rejection.MEASURED), int(Rejection.OUT_OF_FOV), int(Rejection.OUT_OF_RANGE)
_OUT_OF_SENSOR_FOV, _OUT_OF_DEPTH = int(Rejection.OUT_OF_SENSOR_FOV), int(Rejection.OUT_OF_DEPTH)
_GRAZING_SOURCE, _GRAZING_SENSOR = int(Rejection.GRAZING_SOURCE), int(Rejection.GRAZING_SENSOR)


@compiled
def rejections(
    points: Floats, normals: Floats, rows: Ints, T: Floats, limits: tuple[float, ...], tolerance: float,
    codes: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Find the first condition that fails; each is written as a positive condition, so that a NaN fails it.

    Args:
        points: (3, S) coordinates [m].
        normals: (3, S) outward unit normals.
        rows: (N,) points that are tested.
        T: (4, 4) pose of the scanner in their frame [m].
        limits: baseline [m]; tangents of half the field of view, and of the sensor's (0: not limited); range and depth
            [m]; cosines of the grazing limits at source and sensor; cosine and sine of the sensor's tilt.
        tolerance: of planar angles, relative to the distance.
        codes: (N,), overwritten with `planner.ports.Rejection` values; an array created here takes long to compile.
    """
    baseline, tan_h, tan_v, tan_u, tan_w, nearest, farthest, front, back = limits[:9]
    cos_source, cos_sensor, cos_t, sin_t = limits[9:]
    x_x, x_y, x_z = T[0, 0], T[1, 0], T[2, 0]  # axes of the scanner
    y_x, y_y, y_z = T[0, 1], T[1, 1], T[2, 1]
    z_x, z_y, z_z = T[0, 2], T[1, 2], T[2, 2]
    for i in range(len(codes)):
        row = rows[i]
        a, b, c = points[0, row] - T[0, 3], points[1, row] - T[1, 3], points[2, row] - T[2, 3]
        x, y, z = x_x * a + x_y * b + x_z * c, y_x * a + y_y * b + y_z * c, z_x * a + z_y * b + z_z * c
        across = y * y + z * z
        distance = np.sqrt(x * x + across)
        slack = tolerance * distance
        if not (z > 0 and abs(x) <= tan_h * z + slack and abs(y) <= tan_v * z + slack):
            codes[i] = _OUT_OF_FOV
            continue
        a, b, c = normals[0, row], normals[1, row], normals[2, row]
        n_x, n_y, n_z = x_x * a + x_y * b + x_z * c, y_x * a + y_y * b + y_z * c, z_x * a + z_y * b + z_z * c
        u = x - baseline  # from the sensor, along the axes of the scanner frame
        sensor_distance = np.sqrt(u * u + across)
        along, beside = cos_t * z - sin_t * u, cos_t * u + sin_t * z
        slack = tolerance * sensor_distance
        towards_source = -(n_x * x + n_y * y + n_z * z)  # n . (source - p), |p| x cos of the grazing angle
        upright = abs(n_x) + abs(n_y) + abs(n_z) > 0  # a face without area has no normal and is not seen
        if tan_u > 0 and not (along > 0 and abs(beside) <= tan_u * along + slack and abs(y) <= tan_w * along + slack):
            codes[i] = _OUT_OF_SENSOR_FOV
        elif not (distance >= nearest and distance <= farthest):
            codes[i] = _OUT_OF_RANGE
        elif not (z >= front and z <= back):
            codes[i] = _OUT_OF_DEPTH
        elif not (towards_source >= cos_source * distance and upright):
            codes[i] = _GRAZING_SOURCE
        elif not (towards_source + baseline * n_x >= cos_sensor * sensor_distance):
            codes[i] = _GRAZING_SENSOR
        else:
            codes[i] = _MEASURED
