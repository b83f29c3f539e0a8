"""The value that `cell calibrate hand-eye` finds and prints."""

from pydantic import Field

from cell.runs.schema import JsonTable, Transform, Triple

Quaternion = tuple[float, float, float, float]


class MountPrecision(JsonTable):
    """Standard deviations of what is determined, from what is left over."""

    position_mm: Triple = Field(description="of the scanner's origin along x, y, z of the flange")
    turn_deg: Triple = Field(description="of the scanner's orientation about x, y, z of the flange")


class SeenTarget(JsonTable):
    """A scan of the target."""

    file: str
    points: int = Field(description="in the file")
    used: float = Field(description="share of them that is of the target")
    noise_mm: float = Field(description="rms distance of these from the target as this scan has it")
    residual_mm: float = Field(description="of the target from where the other scans have it, by the mount")


class Mounted(JsonTable):
    """What `cell calibrate hand-eye --json` prints."""

    target: str = Field(description="'sphere' or 'plane'")
    T_flange_scanner: Transform = Field(description="the mount")
    position_mm: Triple = Field(description="the same as the scene has it")
    abc_deg: Triple = Field(description="KUKA A B C")
    quaternion: Quaternion = Field(description="the same turn as w, x, y, z")
    precision: MountPrecision | None = Field(description="null where nothing is left over to tell it from")
    rms_mm: float = Field(description="of the residuals of all scans")
    diameter_mm: float | None = Field(description="of the sphere; null for a plane")
    diameter_sd_mm: float | None = Field(description="its standard deviation, 0 where it was given; null for a plane")
    within_mm: float = Field(description="what a direction has to be known to, at the target")
    undetermined: tuple[str, ...] = Field(description="motions of the scanner on the flange that the poses do not show")
    scans: tuple[SeenTarget, ...]

    @property
    def lines(self) -> str:
        """The mount as lines of a scene file."""
        position, abc = (", ".join(f"{number:.6g}" for number in each) for each in (self.position_mm, self.abc_deg))
        w, x, y, z = self.quaternion
        return (
            f"[mount]\nposition_mm = [{position}]\nabc_deg = [{abc}]\n"
            f"# or, in place of abc_deg: quaternion = [{w:.9g}, {x:.9g}, {y:.9g}, {z:.9g}]"
        )

    def rows(self) -> list[tuple[str, str]]:
        """For a table of names and values."""
        worst = max(self.scans, key=lambda scan: scan.residual_mm)
        found = [
            ("mount", f"{_listed(self.position_mm, 3)} mm, A B C {_listed(self.abc_deg, 4)} deg"),
            (
                "standard deviation",
                "not known: more scans tell it"
                if self.precision is None
                else f"{_listed(self.precision.position_mm, 3)} mm, turn {_listed(self.precision.turn_deg, 4)} deg",
            ),
            ("left over", f"{self.rms_mm:.3f} mm rms of {len(self.scans)} scans; most in {worst.file}: "
                          f"{worst.residual_mm:.3f} mm"),
            ("not determined", "\n".join(self.undetermined) or f"nothing (to {self.within_mm:g} mm at the target)"),
        ]  # fmt: skip
        if self.diameter_mm is not None and self.diameter_sd_mm is not None:
            known = f", standard deviation {self.diameter_sd_mm:.4f} mm" if self.diameter_sd_mm else " (given)"
            found.append(("diameter", f"{self.diameter_mm:.4f} mm{known}"))
        return found


def _listed(numbers: Triple, digits: int) -> str:
    return ", ".join(f"{number:.{digits}f}" for number in numbers)
