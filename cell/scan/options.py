"""What `cell scan` can be asked for, checked."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cell.errors import UsageError
from cell.scan.pose_error import Disturbance


@dataclass(frozen=True, slots=True)
class ScanOptions:
    """What `cell scan` was asked for.

    Attributes:
        driver: URL of the controller.
        realtime: let the simulated controller take as long as an arm would.
        view: the one view to scan, from 1 in visiting order; None scans all.
        resolution_deg: in place of the plan's.
        range_noise_mm: one sigma along the ray.
        pose_error_mm: one sigma of the executed position, along each axis.
        pose_error_deg: one sigma of the executed rotation, about each axis.
        register: correct poses by registration; None does it where there is a pose error.
        close_holes: close the holes of the surface, marked.
        seed: of noise and pose error; None takes the plan's.
        confirm_motion: the user's word that an arm of steel may move.
        speed_percent: of the speed that the plan was timed with; None: all of it in simulation, and 10 % of the axis
            speeds on hardware.
        reset: clear a latched fault of the controller before anything moves.
        noise: "model": noise along the ray by the scanner's own sigma, in addition to `range_noise_mm`; or "none".
    """

    driver: str = "sim://"
    realtime: bool = False
    view: int | None = None
    resolution_deg: float | None = None
    range_noise_mm: float = 0.0
    pose_error_mm: float = 0.0
    pose_error_deg: float = 0.0
    register: bool | None = None
    close_holes: bool = False
    seed: int | None = None
    noise: str = "none"
    confirm_motion: bool = False
    speed_percent: float | None = None
    reset: bool = False

    def __post_init__(self) -> None:
        for name, value in (
            ("--range-noise", self.range_noise_mm),
            ("--pose-error", self.pose_error_mm),
            ("--pose-error", self.pose_error_deg),
        ):
            if not 0 <= value < np.inf:
                raise UsageError(f"{name} {value:g} must be 0 or more")
        if self.noise not in ("none", "model"):
            raise UsageError(f"--noise {self.noise} is unknown; it must be none or model")
        if self.resolution_deg is not None and not 0 < self.resolution_deg < np.inf:
            raise UsageError(f"--resolution {self.resolution_deg:g} must be above 0, in degrees")
        if self.speed_percent is not None and not 0 < self.speed_percent <= 100:
            raise UsageError(f"--speed {self.speed_percent:g} must be above 0 and at most 100, in percent")
        if self.seed is not None and self.seed < 0:
            raise UsageError(f"--seed {self.seed} must be 0 or more")

    @property
    def registers(self) -> bool:
        """Whether poses are corrected by registration."""
        return self.disturbance.moves_pose if self.register is None else self.register

    @property
    def disturbance(self) -> Disturbance:
        """Noise and pose error in SI units."""
        return Disturbance(
            self.range_noise_mm / 1000,
            self.pose_error_mm / 1000,
            float(np.radians(self.pose_error_deg)),
            self.noise == "model",
        )

    def kept(self) -> dict[str, Any]:
        """For the manifest: all that a report made later needs, settled."""
        return {**asdict(self), "register": self.registers}
