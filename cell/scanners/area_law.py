"""The law of `laser-area` as far as it needs no ray, compiled: import this module only where it is used.

Spacing: the rays of the grid are equal steps of the two planar angles apart, atan2(x, z) and atan2(y, z). One step `a`
of the first moves the point where a ray meets the plane through p with the normal n by

    a z (1 + x^2 / z^2) (e_x - p n_x / (n . p))

to first order: the derivative of z (tan(angle), y / z, 1) along the plane. The second is the same with y and e_y.
"""

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.ports import Rejection
from planner.values import Floats

_MEASURED, _OUT_OF_FOV, _OUT_OF_RANGE = int(Rejection.MEASURED), int(Rejection.OUT_OF_FOV), int(Rejection.OUT_OF_RANGE)
_OUT_OF_SENSOR_FOV, _OUT_OF_DEPTH = int(Rejection.OUT_OF_SENSOR_FOV), int(Rejection.OUT_OF_DEPTH)
_GRAZING_SOURCE, _GRAZING_SENSOR = int(Rejection.GRAZING_SOURCE), int(Rejection.GRAZING_SENSOR)
_TOO_SPARSE = int(Rejection.TOO_SPARSE)


@compiled
def on_the_plane(x: float, y: float, z: float, n_x: float, n_y: float, n_z: float) -> tuple[float, float]:
    """How far a point moves along the plane with its normal when its ray moves by 1 along x, and by 1 along y.

    It is |e_x - p n_x / (n . p)| and the same of y; inf where the plane does not face the origin.
    """
    along = n_x * x + n_y * y + n_z * z
    if not along < 0:
        return np.inf, np.inf
    k, m = n_x / along, n_y / along
    in_x = np.sqrt((1 - x * k) ** 2 + (y * k) ** 2 + (z * k) ** 2)
    return in_x, np.sqrt((x * m) ** 2 + (1 - y * m) ** 2 + (z * m) ** 2)


@compiled
def grid_spacing(
    x: float, y: float, z: float, n_x: float, n_y: float, n_z: float, step_x: float, step_y: float
) -> float:
    """Larger distance of neighbouring points on the surface [m], for steps of the planar angles [rad]."""
    in_x, in_y = on_the_plane(x, y, z, n_x, n_y, n_z)
    return max(step_x * (z + x * x / z) * in_x, step_y * (z + y * y / z) * in_y)


@compiled
def spacings(points: Floats, normals: Floats, step_x: float, step_y: float) -> Floats:
    """(N,) `grid_spacing` of (3, N) points [m] and normals; inf behind the scanner."""
    found = np.full(points.shape[1], np.inf)
    for i in range(len(found)):
        if points[2, i] > 0:
            x, y, z = points[0, i], points[1, i], points[2, i]
            found[i] = grid_spacing(x, y, z, normals[0, i], normals[1, i], normals[2, i], step_x, step_y)
    return found


@compiled
def rejections(points: Floats, normals: Floats, limits: tuple[float, ...], tolerance: float) -> NDArray[np.uint8]:
    """The first condition that fails; each is written as what holds, so that a NaN fails it.

    Args:
        points: (3, N) coordinates [m], scanner frame.
        normals: (3, N) outward unit normals, scanner frame.
        limits: baseline [m]; tangents of half the field of view, and of the sensor's (0: not limited); range and depth
            [m]; cosines of the grazing limits at source and sensor; cosine and sine of the sensor's tilt; steps of the
            grid [rad] and the limit on spacing [m], inf: not limited.
        tolerance: of planar angles, relative to the distance.
    """
    baseline, tan_h, tan_v, tan_u, tan_w, nearest, farthest, front, back = limits[:9]
    cos_source, cos_sensor, cos_t, sin_t, step_x, step_y, sparsest = limits[9:]
    codes = np.empty(points.shape[1], dtype=np.uint8)
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
        elif sparsest < np.inf and not grid_spacing(x, y, z, n_x, n_y, n_z, step_x, step_y) <= sparsest:
            codes[i] = _TOO_SPARSE
        else:
            codes[i] = _MEASURED
    return codes
