"""`laser-area`: a triangulation scanner that sweeps a rectangular grid of rays (Sections 3.3 and 3.6 of the paper).

The source is the origin of the scanner frame and looks along +z; the sensor is a baseline away along +x. A point is in
the frustum (the paper's spherical cone) if its two planar angles are, |atan2(x, z)| <= FOV_h / 2 and |atan2(y, z)| <=
FOV_v / 2, and its distance from the source is within the range. The grazing angle is between the outward normal and the
direction to the source (or to the sensor). Three conditions are optional: the sensor's own field of view, two planar
angles about its axis; the depth of field, limits of the depth z; and the largest spacing of neighbouring points on the
surface. The sensor's axis lies in the plane of the baseline (x, z) and is tilted towards the source; by default it
meets the source's axis in the middle of the working range.

`sigma` is the expected standard deviation of a point along its ray: docs/internals/sigma_model.md.

Every limit is inclusive. `TOLERANCE` (relative for lengths, absolute for tangents and cosines) covers the rounding of
float64 transforms, so that a point exactly on a limit counts: 0.3 nm at 0.3 m, 1e-9 rad at 75 degrees; near 0 degrees,
where the cosine is flat, 0.003 degrees.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from planner.ports import Rejection
from planner.values import Floats, Ints, readonly

if TYPE_CHECKING:
    from pydantic import JsonValue

TOLERANCE = 1e-9

_N_DIRECTIONS = 33  # directions along each half of the field of view that are searched for the densest

SIGMA_ANGLE_MDEG = 1.5
"""A twentieth of a pixel if 2048 pixels see 60 degrees; the value of a real sensor is in its data sheet."""


_PAIRS = ("fov_deg", "resolution_deg", "range_mm", "sensor_fov_deg", "depth_of_field_mm")
_LIMITS: tuple[tuple[tuple[str, ...], Callable[[Any], bool], str], ...] = (
    (("max_spacing_mm",), lambda length: length > 0, "it must be above 0"),
    (("sensor_tilt_deg",), lambda angle: -90 < angle < 90, "it must be between -90 and 90"),
    (("fov_deg", "sensor_fov_deg"), lambda both: 0 < min(both) <= max(both) < 180,
     "each angle must be above 0 and below 180"),
    (("depth_of_field_mm", "range_mm"), lambda ends: 0 <= ends[0] < ends[1],
     "it must be [min, max] with 0 <= min < max"),
    (("sigma_angle_mdeg", "baseline_mm"), lambda value: value >= 0, "it must be 0 or more"),
    (("resolution_deg",), lambda both: min(both) > 0, "each angle must be above 0"),
    (("grazing_max_deg", "sensor_grazing_max_deg"), lambda angle: 0 <= angle <= 90, "it must be from 0 to 90"),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LaserArea:
    """A laser scanner with an area field of view.

    Attributes:
        fov_deg: (horizontal, vertical) full opening angles [deg], above 0 and below 180.
        resolution_deg: (horizontal, vertical) angle between neighbouring rays [deg].
        range_mm: (smallest, largest) distance of a point from the source [mm].
        baseline_mm: distance of the sensor from the source along +x [mm]; 0 makes the scanner monostatic.
        grazing_max_deg: largest grazing angle of the active ray, towards the source [deg], 0 to 90.
        sensor_grazing_max_deg: largest grazing angle of the reflected ray, towards the sensor [deg], 0 to 90.
        sensor_fov_deg: (horizontal, vertical) opening angles of the sensor about its axis [deg]; None: not limited.
        sensor_tilt_deg: angle of the sensor's axis from z towards the source [deg], 0: parallel to z; None: it meets
            the source's axis in the middle of the depth of field, or of the range without one.
        depth_of_field_mm: (smallest, largest) depth z of a point [mm]; None: not limited.
        sigma_angle_mdeg: standard deviation of the direction in which the sensor sees the spot [1e-3 deg], on a surface
            that faces source and sensor.
        max_spacing_mm: largest distance of neighbouring points on the surface, in both directions of the grid [mm];
            None: not limited.
    """

    type_name: ClassVar[str] = "laser-area"

    fov_deg: tuple[float, float] = (60.0, 60.0)
    resolution_deg: tuple[float, float] = (0.25, 0.25)
    range_mm: tuple[float, float] = (150.0, 450.0)
    baseline_mm: float = 75.0
    grazing_max_deg: float = 75.0
    sensor_grazing_max_deg: float = 90.0
    sensor_fov_deg: tuple[float, float] | None = None
    sensor_tilt_deg: float | None = None
    depth_of_field_mm: tuple[float, float] | None = None
    sigma_angle_mdeg: float = SIGMA_ANGLE_MDEG
    max_spacing_mm: float | None = None
    _shape: tuple[int, int] = field(init=False, repr=False)
    _limits: tuple[float, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for each in fields(self):
            if each.init and ((value := getattr(self, each.name)) is not None or each.default is not None):
                object.__setattr__(self, each.name, (pair if each.name in _PAIRS else _number)(each.name, value))
        for names, is_valid, rule in _LIMITS:
            for name in names:
                if (value := getattr(self, name)) is not None and not is_valid(value):
                    text = list(value) if isinstance(value, tuple) else f"{value:g}"
                    raise SceneError(f"scanner.{name} is {text}; {rule}")
        both = list(zip(self.fov_deg, self.resolution_deg, strict=True))
        n_h, n_v = (round(fov / step) for fov, step in both)
        if any(step > fov for fov, step in both):
            raise SceneError(
                f"scanner.resolution_deg {list(self.resolution_deg)} gives no ray in a field of view of "
                f"{list(self.fov_deg)}; it must be at most the field of view"
            )
        object.__setattr__(self, "_shape", (n_v, n_h))
        object.__setattr__(self, "_limits", self._constants())
        if self.max_spacing_mm is not None:
            require_attainable(self.max_spacing_mm, self.least_spacing_mm)

    @property
    def source(self) -> Floats:
        """(3,) the laser source [m], scanner frame: the origin."""
        return np.zeros(3)

    @property
    def sensor(self) -> Floats:
        """(3,) the sensor [m], scanner frame: the baseline along +x."""
        return np.array([self.baseline_mm / 1000, 0.0, 0.0])

    @property
    def grid_shape(self) -> tuple[int, int]:
        """(n_v, n_h) rays of one scan, round(FOV / resolution) per axis: Eq. 1 of the paper."""
        return self._shape

    def parameters(self) -> "dict[str, JsonValue]":
        """Return the arguments of this scanner, named as in the scene file and the run folder."""
        limits: dict[str, JsonValue] = {
            "type": self.type_name,
            "fov_deg": list(self.fov_deg),
            "resolution_deg": list(self.resolution_deg),
            "range_mm": list(self.range_mm),
            "baseline_mm": self.baseline_mm,
            "grazing_max_deg": self.grazing_max_deg,
            "sensor_grazing_max_deg": self.sensor_grazing_max_deg,
        }
        if self.sensor_fov_deg is not None:  # unused limits are omitted, so that old matrices and folders stay valid
            limits |= {"sensor_fov_deg": list(self.sensor_fov_deg), "sensor_tilt_deg": math.degrees(self.sensor_tilt)}
        if self.depth_of_field_mm is not None:
            limits["depth_of_field_mm"] = list(self.depth_of_field_mm)
        if self.max_spacing_mm is not None:
            limits["max_spacing_mm"] = self.max_spacing_mm
        return limits | {"sigma_angle_mdeg": self.sigma_angle_mdeg}

    @property
    def sensor_tilt(self) -> float:
        """Angle of the sensor's axis from z towards the source [rad]."""
        if self.sensor_tilt_deg is not None:
            return math.radians(self.sensor_tilt_deg)
        near, far = self.depth_of_field_mm or self.range_mm
        return math.atan2(self.baseline_mm, (near + far) / 2)

    def ray_directions(self) -> Floats:
        """Return unit directions (n_v * n_h, 3), scanner frame, row by row, through the middles of the FOV's cells."""
        n_v, n_h = self._shape
        across, down = (
            np.tan(np.radians(((np.arange(count) + 0.5) / count - 0.5) * fov))
            for count, fov in ((n_h, self.fov_deg[0]), (n_v, self.fov_deg[1]))
        )
        x, y = np.meshgrid(across, down)
        directions = np.stack([x.ravel(), y.ravel(), np.ones(n_v * n_h)], axis=1)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return readonly("ray directions", directions, (None, 3))

    def reject(self, points: Floats, normals: Floats) -> NDArray[np.uint8]:
        """Find the first failed condition that needs no ray cast: FOV, range, depth, grazing; the source's first.

        A normal of zero or NaN counts as grazing; see `planner.ports.Scanner.reject`.
        """
        # Read-only copies have the type of the planner's arrays, so that one form of the kernel is compiled.
        x_y_z, n_x_y_z = (np.array(vectors.T, dtype=np.float64, order="C") for vectors in (points, normals))
        for array in (x_y_z, n_x_y_z):
            array.setflags(write=False)
        codes = self.reject_at(x_y_z, n_x_y_z, np.arange(len(points)), np.eye(4))
        if self.max_spacing_mm is not None:
            passed = np.flatnonzero(codes == Rejection.MEASURED)
            dense = self.spacing(points[passed], normals[passed]) <= self.max_spacing_mm / 1000 * (1 + TOLERANCE)
            codes[passed[~dense]] = Rejection.TOO_SPARSE
        return codes

    def reject_at(self, points: Floats, normals: Floats, rows: Ints, T: Floats) -> NDArray[np.uint8]:
        """Find the first failed condition of points in another frame; see `planner.ports.AreaLimits`."""
        from cell.scanners.area_law import rejections  # numba is kept out of the start-up

        codes = np.empty(len(rows), dtype=np.uint8)
        rejections(points, normals, rows, T, self._limits, TOLERANCE, codes)
        return codes

    @property
    def area_limits(self) -> tuple[float, ...] | None:
        """`planner.ports.AreaLimits`; None with a limit on the spacing, and for a subclass with another law."""
        has_own_law = type(self).reject is not LaserArea.reject
        return None if has_own_law or self.max_spacing_mm is not None else self._limits

    def _constants(self) -> tuple[float, ...]:
        """Return the limits of `cell.scanners.area_law.rejections`, with `TOLERANCE` applied where it is constant."""
        angles = (*self.fov_deg, *(self.sensor_fov_deg or (0.0, 0.0)))
        lengths = (self.range_mm, self.depth_of_field_mm or (-math.inf, math.inf))
        return (
            self.baseline_mm / 1000,
            *(math.tan(math.radians(angle / 2)) for angle in angles),
            *(end / 1000 * (1 + side * TOLERANCE) for ends in lengths for side, end in zip((-1, 1), ends, strict=True)),
            *(math.cos(math.radians(a)) - TOLERANCE for a in (self.grazing_max_deg, self.sensor_grazing_max_deg)),
            math.cos(self.sensor_tilt),
            math.sin(self.sensor_tilt),
        )

    @property
    def least_spacing_mm(self) -> float:
        """Smallest possible spacing [mm]: on a surface that faces the source at the near end of the range."""
        x, y = np.meshgrid(*(np.linspace(0, math.tan(math.radians(fov / 2)), _N_DIRECTIONS) for fov in self.fov_deg))
        directions = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return 1000 * float(self.spacing(self.range_mm[0] / 1000 * directions, -directions).min())

    def spacing(self, points: Floats, normals: Floats) -> Floats:
        """Compute the distance (N,) of neighbouring points [m], the larger one of the grid's two directions.

        It is inf where the source does not face the surface. On the axis, in front of a wall that is turned by t about
        the vertical, it is z times the angle between rays over cos t.

        The rays of the grid are equal steps of the two planar angles apart, atan2(x, z) and atan2(y, z). One step `a`
        of the first moves the intersection of a ray with the plane through p with the normal n by

            a z (1 + x^2 / z^2) (e_x - p n_x / (n . p))

        to first order: the derivative of z (tan(angle), y / z, 1) along the plane. The second is the same with y, e_y.
        """
        x, y, z = np.ascontiguousarray(points.T)
        n_x, n_y, n_z = np.ascontiguousarray(normals.T)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            along = n_x * x + n_y * y + n_z * z
            k, m = n_x / along, n_y / along
            in_x = np.sqrt((1 - x * k) ** 2 + (y * k) ** 2 + (z * k) ** 2)
            in_y = np.sqrt((x * m) ** 2 + (1 - y * m) ** 2 + (z * m) ** 2)
            step_x, step_y = (math.radians(fov) / n for fov, n in zip(self.fov_deg, self._shape[::-1], strict=True))
            spacing = np.maximum(step_x * (z + x * x / z) * in_x, step_y * (z + y * y / z) * in_y)
        return np.where((z > 0) & (along < 0), spacing, np.inf)

    def sigma(self, points: Floats, normals: Floats) -> Floats:
        """Compute the expected standard deviation (N,) of measured points along the ray from the source [m].

        sigma = sigma_angle d / sin(gamma) / (cos(theta) sqrt(cos(phi))) with the distance d from the sensor, the angle
        gamma between the two rays and the incidence angles theta of the laser and phi of the line of sight:
        docs/internals/sigma_model.md derives it. On the source's axis, in front of a wall, it is sigma_angle
        (z^2 + b^2) / b. It is inf where a ray does not meet the front of the surface, or the rays form no triangle
        (baseline 0, a point on the line through source and sensor).
        """
        x, y, z = points.T
        n_x, n_y, n_z = normals.T
        baseline = self.baseline_mm / 1000
        across = y * y + z * z
        distance, sensor_distance = np.sqrt(x * x + across), np.sqrt((x - baseline) ** 2 + across)
        towards_source = -(n_x * x + n_y * y + n_z * z)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            cos_source = towards_source / distance
            cos_sensor = (towards_source + baseline * n_x) / sensor_distance
            sine = baseline * np.sqrt(across) / (distance * sensor_distance)  # of the angle between the two rays
            possible = (cos_source > 0) & (cos_sensor > 0) & (sine > 0)
            spread = math.radians(self.sigma_angle_mdeg / 1000) / (cos_source * np.sqrt(np.maximum(cos_sensor, 0)))
            sigma: Floats = np.where(possible, spread * sensor_distance / sine, np.inf)
        return sigma


def require_attainable(limit_mm: float, least_mm: float) -> None:
    """Refuse a limit on the spacing below the smallest spacing in the scanner's range.

    Raises:
        SceneError: with both.
    """
    if limit_mm < least_mm * (1 - 1e-3):
        raise SceneError(
            f"scanner.max_spacing_mm is {limit_mm:g}, and at the near end of its range this scanner's points are "
            f"{least_mm:.3g} mm apart; increase the limit, or use a finer grid or a scanner with a nearer range"
        )


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise SceneError(f"scanner.{name} is {value!r}; it must be a finite number")
    return float(value)


def pair(name: str, value: object) -> tuple[float, float]:
    """Convert a value of the scene to two finite numbers; SceneError for any other value."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise SceneError(f"scanner.{name} is {value!r}; it must be a pair of numbers")
    return _number(name, value[0]), _number(name, value[1])
