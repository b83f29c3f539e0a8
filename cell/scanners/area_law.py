"""Conditions of `laser-area` that need no ray cast, compiled: import this module only where it is used."""

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.ports import Rejection
from planner.values import Floats

_MEASURED, _OUT_OF_FOV, _OUT_OF_RANGE = int(Rejection.MEASURED), int(Rejection.OUT_OF_FOV), int(Rejection.OUT_OF_RANGE)
_OUT_OF_SENSOR_FOV, _OUT_OF_DEPTH = int(Rejection.OUT_OF_SENSOR_FOV), int(Rejection.OUT_OF_DEPTH)
_GRAZING_SOURCE, _GRAZING_SENSOR = int(Rejection.GRAZING_SOURCE), int(Rejection.GRAZING_SENSOR)


@compiled
def rejections(
    points: Floats, normals: Floats, limits: tuple[float, ...], tolerance: float, codes: NDArray[np.uint8]
) -> None:
    """Find the first condition that fails; each is written as a positive condition, so that a NaN fails it.

    Args:
        points: (3, N) coordinates [m], scanner frame.
        normals: (3, N) outward unit normals, scanner frame.
        limits: baseline [m]; tangents of half the field of view, and of the sensor's (0: not limited); range and depth
            [m]; cosines of the grazing limits at source and sensor; cosine and sine of the sensor's tilt.
        tolerance: of planar angles, relative to the distance.
        codes: (N,), overwritten with `planner.ports.Rejection` values; an array created here takes long to compile.
    """
    baseline, tan_h, tan_v, tan_u, tan_w, nearest, farthest, front, back = limits[:9]
    cos_source, cos_sensor, cos_t, sin_t = limits[9:]
    for i in range(len(codes)):
        x, y, z = points[0, i], points[1, i], points[2, i]
        n_x, n_y, n_z = normals[0, i], normals[1, i], normals[2, i]
        across = y * y + z * z
        distance = np.sqrt(x * x + across)
        slack = tolerance * distance
        if not (z > 0 and abs(x) <= tan_h * z + slack and abs(y) <= tan_v * z + slack):
            codes[i] = _OUT_OF_FOV
            continue
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
