"""`laser-line`: a triangulation sensor with one laser sheet, moved along a line or turned (`viewpoints.sweeps`).

The sheet is the plane x = 0 of the scanner frame: the fan opens by `fan_deg` about z within it, along y, and the
baseline (x) is perpendicular to it, as in real line sensors, where the camera looks at the line from the side. The
source (the fan's apex) is the origin.

Pose k of a sweep measures a surface point if it is within half a step of that pose's sheet and every condition holds
there, at the position of the point:

    fan      |atan2(y, z)| <= fan / 2
    range    near <= z <= far: the depth along z, as in data sheets, not the distance from the source
    grazing  the angle between normal and laser, and between normal and line of sight, as for `laser-area`

The step is the sweep divided by the number of poses (`sweep_mm` / `sweep_steps`, or `sweep_deg` / `sweep_steps`), so
that the poses tile the sweep. Every limit is inclusive, with the tolerances of `laser-area`.

The distance of neighbouring points along the line follows from the angle between them, and across the line from the
distance between two lines: the full speed of a sweep (`planner.path.sweep_line`) over `profile_rate_hz`; a slower sweep
is denser. `max_spacing_mm` limits both, on the surface at that depth and incidence.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from cell.scanners.laser_area import SIGMA_ANGLE_MDEG, TOLERANCE, LaserArea, pair, require_attainable
from planner.path.sweep_line import DEFAULT_SPEED
from planner.ports import Rejection
from planner.values import Floats, readonly
from planner.viewpoints.viewpoints import straight_sweep_poses, turned_sweep_poses

if TYPE_CHECKING:
    from pydantic import JsonValue

_ACROSS_DEG = 179.0  # opening across the sheet of the area sensor: the slab decides instead, and is always narrower
_NO_LIMIT_MM = (0.0, 1e9)  # range of the area sensor: the depth decides instead


@dataclass(frozen=True, slots=True, eq=False)
class LaserLine:
    """A laser line sensor and its sweep.

    Attributes:
        fan_deg: full opening angle of the laser sheet [deg], above 0 and below 180; real sensors have 26 to 30.
        range_mm: (smallest, largest) depth z of a point, from the source [mm].
        baseline_mm: distance of the sensor from the source along +x [mm].
        grazing_max_deg: largest grazing angle towards the source [deg], 0 to 90.
        sensor_grazing_max_deg: largest grazing angle towards the sensor [deg], 0 to 90.
        sweep_mm: length of a straight sweep along the baseline [mm]; without `sweep_mm` and `sweep_deg` it is the
            length of the line in the middle of the range.
        sweep_deg: instead of `sweep_mm`: angle by which the sheet is turned about the line through the source [deg].
        sweep_steps: number of poses of a sweep.
        line_points: number of points of a line, at equal angles.
        sigma_angle_mdeg: noise of the direction in which the sensor sees the line [1e-3 deg], as for `laser-area`.
        profile_rate_hz: lines per second; None: unknown, so that the spacing across the lines is unknown too.
        max_spacing_mm: largest distance of neighbouring points on the surface, along and across the lines [mm]; None:
            not limited.
    """

    type_name: ClassVar[str] = "laser-line"

    fan_deg: float = 28.0
    range_mm: tuple[float, float] = (150.0, 450.0)
    baseline_mm: float = 75.0
    grazing_max_deg: float = 75.0
    sensor_grazing_max_deg: float = 90.0
    sweep_mm: float | None = None
    sweep_deg: float | None = None
    sweep_steps: int = 8
    line_points: int = 640
    sigma_angle_mdeg: float = SIGMA_ANGLE_MDEG
    profile_rate_hz: float | None = None
    max_spacing_mm: float | None = None
    _law: LaserArea = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check()
        across = _ACROSS_DEG if self.sweep_deg is None else self.sweep_deg / self.sweep_steps
        # Within the sheet the line sensor is an area sensor with a fan for a field of view and limits of depth.
        law = LaserArea(
            fov_deg=(across, self.fan_deg),
            resolution_deg=(across, self.fan_deg / self.line_points),
            range_mm=_NO_LIMIT_MM,
            baseline_mm=self.baseline_mm,
            grazing_max_deg=self.grazing_max_deg,
            sensor_grazing_max_deg=self.sensor_grazing_max_deg,
            depth_of_field_mm=self.range_mm,
            sigma_angle_mdeg=self.sigma_angle_mdeg,
        )
        object.__setattr__(self, "_law", law)
        object.__setattr__(self, "range_mm", law.depth_of_field_mm)
        if self.sweep_mm is None and self.sweep_deg is None:
            width = math.tan(math.radians(self.fan_deg / 2)) * sum(self.range_mm)
            object.__setattr__(self, "sweep_mm", width)
        if self.max_spacing_mm is not None:
            require_attainable(self.max_spacing_mm, self.least_spacing_mm or 0.0)

    def _check(self) -> None:
        """Check the keys that the area sensor does not check, or would name differently."""
        if self.sweep_mm is not None and self.sweep_deg is not None:
            raise SceneError("scanner.sweep_mm and scanner.sweep_deg both describe the sweep; give one of them")
        for name, below in (("fan_deg", 180.0), ("sweep_mm", math.inf), ("sweep_deg", 180.0)):
            value = getattr(self, name)
            if name != "fan_deg" and value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < below:
                limit = "" if below == math.inf else f" and below {below:g}"
                raise SceneError(f"scanner.{name} is {value!r}; it must be a finite number above 0{limit}")
        for name in ("profile_rate_hz", "max_spacing_mm"):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not 0 < value < math.inf):
                raise SceneError(f"scanner.{name} is {value!r}; it must be a finite number above 0")
        if self.max_spacing_mm is not None and self.profile_rate_hz is None:
            raise SceneError(
                "scanner.max_spacing_mm limits the distance between lines too, and the rate of lines is not known; set "
                "scanner.profile_rate_hz"
            )
        for name in ("sweep_steps", "line_points"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise SceneError(f"scanner.{name} is {value!r}; it must be a whole number of at least 1")
        near, far = pair("range_mm", self.range_mm)
        if not 0 <= near < far:
            raise SceneError(f"scanner.range_mm is {[near, far]}; it must be [min, max] with 0 <= min < max")

    @property
    def source(self) -> Floats:
        """(3,) the laser source [m], scanner frame: the origin, the fan's apex."""
        return self._law.source

    @property
    def sensor(self) -> Floats:
        """(3,) the sensor [m], scanner frame: the baseline along +x, perpendicular to the sheet."""
        return self._law.sensor

    @property
    def T_view_scanner(self) -> Floats:
        """(K, 4, 4) poses of one sweep in the frame of the viewpoint that is its middle [m]."""
        if self.sweep_deg is not None:
            return turned_sweep_poses(math.radians(self.sweep_deg), self.sweep_steps)
        return straight_sweep_poses(self._sweep_length, self.sweep_steps)

    @property
    def grid_shape(self) -> tuple[int, int]:
        """(n_v, n_h) rays of one line: the points along y, and one across."""
        return self.line_points, 1

    def parameters(self) -> "dict[str, JsonValue]":
        """Return the arguments of this scanner, named as in the scene file and the run folder."""
        sweep = {"sweep_mm": self.sweep_mm} if self.sweep_deg is None else {"sweep_deg": self.sweep_deg}
        return {
            "type": self.type_name,
            "fan_deg": self.fan_deg,
            "range_mm": list(self.range_mm),
            "baseline_mm": self.baseline_mm,
            "grazing_max_deg": self.grazing_max_deg,
            "sensor_grazing_max_deg": self.sensor_grazing_max_deg,
            **sweep,
            "sweep_steps": self.sweep_steps,
            "line_points": self.line_points,
            "sigma_angle_mdeg": self.sigma_angle_mdeg,
            **({} if self.profile_rate_hz is None else {"profile_rate_hz": self.profile_rate_hz}),
            **({} if self.max_spacing_mm is None else {"max_spacing_mm": self.max_spacing_mm}),
        }

    def ray_directions(self) -> Floats:
        """Return unit directions (line_points, 3) in the sheet, scanner frame, through the middles of equal angles."""
        angles = np.radians(((np.arange(self.line_points) + 0.5) / self.line_points - 0.5) * self.fan_deg)
        rays = np.stack([np.zeros(self.line_points), np.sin(angles), np.cos(angles)], axis=1)
        return readonly("ray directions", rays, (None, 3))

    def reject(self, points: Floats, normals: Floats) -> NDArray[np.uint8]:
        """Find the first failed condition that needs no ray cast: sheet and fan, range, grazing, spacing.

        A normal of zero or NaN counts as grazing; see `planner.ports.Scanner.reject`.
        """
        if self.sweep_deg is None:
            # Most points are off the sheet: no other condition is tested for them.
            half = self._sweep_length / self.sweep_steps / 2
            near = np.abs(points[:, 0]) <= half + TOLERANCE * (np.abs(points[:, 2]) + half)
            codes = np.full(len(points), Rejection.OUT_OF_FOV, dtype=np.uint8)
            rows = np.flatnonzero(near)
            codes[rows] = self._law.reject(points[rows], normals[rows])
        else:
            codes = self._law.reject(points, normals)
        codes[codes == Rejection.OUT_OF_DEPTH] = Rejection.OUT_OF_RANGE  # the depth is this sensor's range
        if self.max_spacing_mm is not None:
            passed = np.flatnonzero(codes == Rejection.MEASURED)
            limit = self.max_spacing_mm / 1000 * (1 + TOLERANCE)
            codes[passed[~(self._spacing(points[passed], normals[passed]) <= limit)]] = Rejection.TOO_SPARSE
        return codes

    @property
    def spacing(self) -> Callable[[Floats, Floats], Floats] | None:
        """`planner.ports.SpacingScanner.spacing`; None if the rate of lines is unknown."""
        return None if self.profile_rate_hz is None else self._spacing

    @property
    def least_spacing_mm(self) -> float | None:
        """Spacing on a surface that faces the source at the near end of the range [mm]; None: unknown."""
        facing = np.array([[0.0, 0.0, self.range_mm[0] / 1000]]), np.array([[0.0, 0.0, -1.0]])
        return None if self.profile_rate_hz is None else 1000 * float(self._spacing(*facing)[0])

    def _spacing(self, points: Floats, normals: Floats) -> Floats:
        """Return the larger distance (N,) of neighbouring points, along the line and to the next one [m].

        With p the point in the sheet (its x left out), r its distance from the source and n its normal: along the line
        r^2 |(n_y, n_z)| / |n . p| for each rad; across it sqrt(1 + (r n_x / n . p)^2) for each m that the sheet moves,
        which is z for each rad that it turns.
        """
        assert self.profile_rate_hz is not None
        _, y, z = points.T
        n_x, n_y, n_z = normals.T
        r, towards = np.hypot(y, z), -(n_y * y + n_z * z)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = math.radians(self.fan_deg) / self.line_points * r * r * np.hypot(n_y, n_z) / towards
            across = np.sqrt(1 + (r * n_x / towards) ** 2) / self.profile_rate_hz
            across *= DEFAULT_SPEED.linear if self.sweep_deg is None else DEFAULT_SPEED.angular * z
            spacing: Floats = np.where(towards > 0, np.maximum(along, across), np.inf)
        return spacing

    def sigma(self, points: Floats, normals: Floats) -> Floats:
        """Compute the expected standard deviation (N,) along the ray from the source [m], as for `laser-area`."""
        return self._law.sigma(points, normals)

    @property
    def _sweep_length(self) -> float:
        """Length of a straight sweep [m]."""
        assert self.sweep_mm is not None
        return self.sweep_mm / 1000
