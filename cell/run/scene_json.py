"""scene.resolved.json: all that a plan used, what the scene left open settled, and all that stood in the cell."""

from typing import Literal

from pydantic import ConfigDict, Field

from cell.run.json_table import JsonTable, OpenTable, Transform, Triple, optional
from cell.scene.plan_settings import PlanKeys
from cell.scene.regions import RegionWishes


class ResolvedPart(JsonTable):
    """The part as it was given."""

    name: str = Field(description="of the built-in part or of the file")
    units: str | None = Field(description="of the file; null for a built-in part")
    sha256: str = Field(description="of the file")


class ScannerKeys(OpenTable):
    """The scanner: calling the class of its type with the other keys makes it again (docs/scanners.md)."""

    type: str = Field(description="name of the plug-in")

    @property
    def opening_deg(self) -> tuple[float, float]:
        """Angles (across, along) that stand for it in pictures [deg]: its field of view, or a line's thin fan.

        A scanner that states neither is drawn 10 degrees wide.
        """
        fan = self.number("fan_deg")
        return self.pair("fov_deg") or ((10.0, 10.0) if fan is None else (0.5, fan))

    @property
    def drawn_range_mm(self) -> tuple[float, float]:
        """Smallest and largest distance in pictures [mm]; 100 to 300 of a scanner that states none."""
        return self.pair("range_mm") or (100.0, 300.0)


class ResolvedRobot(JsonTable):
    """A robot that is not built in, or that does not stand in the origin."""

    model: Literal["kr16", "robot.xml"] = Field(description="the built-in robot, or the run's own file of another")
    name: str = Field(description="of the file that the scene names, or kr16")
    T_base: Transform = Field(description="where its base stands in the cell's frame")


class ResolvedTable(JsonTable):
    """The rotary table that turns the part, a cylinder below its face; E1 is its angle, 0 the placement."""

    T_base_table: Transform = Field(description="the middle of its face; it turns about z, right-handed")
    diameter_mm: float = Field(description="of the cylinder")
    height_mm: float = Field(description="of the cylinder")
    swing_mm: float = Field(description="diameter of the circle that the part may swing through")
    limits_deg: tuple[float, float] | None = Field(description="smallest and largest angle; null: endless")
    turn_deg: tuple[float, float] | None = optional("of these, as far as the part keeps clear of what stands beside it")
    velocity_deg_s: float = Field(description="at full speed")
    acceleration_deg_s2: float = Field(description="at full acceleration")
    jerk_deg_s3: float = Field(description="at full acceleration")
    moves: Literal["synchronised", "indexed"] = Field(
        default="synchronised", description="together with the arm, or while the arm stands clear of all that is turned"
    )
    angles: int = Field(description="over a turn, at which views were looked for")
    post_mm: float | None = optional("of a table under the part: how far its face is below the part's lowest point")


class ResolvedHousing(JsonTable):
    """The scanner's body and the bracket between it and the flange."""

    shape: Literal["box"] = "box"
    size_mm: Triple = Field(description="along x, y, z of its own frame")
    T_flange_housing: Transform = Field(description="its middle")
    bracket_diameter_mm: float = Field(description="of the round bracket")


class StandingFixture(JsonTable):
    """Something fixed that stands in the cell: of the scene, or post, pedestal and floor."""

    name: str = Field(description="of its own")
    shape: Literal["box", "cylinder", "mesh", "plane"] = Field(description="what it is; a plane is endless")
    size_mm: tuple[float, ...] = Field(description="box and mesh x, y, z; cylinder diameter and height; plane nothing")
    pose: Transform = Field(description="of its middle in the frame it is attached to; of a mesh that of its file")
    attached_to: Literal["base", "object"] = Field(description="frame that it moves with")
    occludes: bool = Field(description="whether it stands in the way of rays")
    built_in: bool = Field(description="whether it is post, pedestal or floor")
    file: str | None = optional("the triangles of a mesh, mm, in the frame that it is attached to")
    collision: Literal["hull", "exact"] | None = optional(
        "what a mesh was to the collision check: exact or hull; not said: its hull"
    )


class ResolvedPlan(PlanKeys):
    """The scene's `[plan]`, its keys settled; what an older run lacks is the default now."""

    model_config = ConfigDict(extra="ignore", defer_build=True)

    collision: Literal["hull", "decomposed", "exact"] = Field(  # type: ignore[assignment] # runs of earlier versions
        default="hull", description="what the part was to the collision check; not said: its hull"
    )
    planning_faces: int | None = Field(default=None, description="of planning.ply, what came out for `faces`")
    sphere_radius_mm: float | None = Field(default=None, description="of the view sphere")


class ResolvedRegion(RegionWishes):
    """What was asked of a region; faces of reference.ply have its number, from 0, as `region` (-1: nobody cares)."""

    model_config = ConfigDict(extra="ignore", defer_build=True)


class ResolvedScene(JsonTable):
    """The file."""

    units: str = "transforms are 4x4 in metres; the rest as names say"
    part: ResolvedPart
    T_base_object: Transform = Field(description="the part's file in base")
    T_object_centre: Transform = Field(description="the middle of its bounding box in the object frame")
    T_flange_scanner: Transform = Field(description="the scanner frame in the flange frame")
    scanner: ScannerKeys
    planning_resolution_deg: float = Field(description="between rays that fill the matrix, with `fill` 'rays'")
    housing: ResolvedHousing
    robot: ResolvedRobot | None = optional(
        "which robot, and where its base stands; else the built-in one in the origin"
    )
    table: ResolvedTable | None = optional("turns part, post and the part's fixtures")
    fixtures: tuple[StandingFixture, ...] = Field(description="of the scene, and post, pedestal and floor")
    # The built-in home is whole numbers, and the file keeps what the scene has.
    home_deg: tuple[int | float, ...] = Field(description="joint angles at which the motion begins and ends")
    joint_limits_deg: tuple[tuple[float, float], ...] = Field(description="lower and upper of each axis")
    joint_velocity_limits_deg_s: tuple[float, ...] = Field(description="of each axis at full speed")
    joint_acceleration_limits_deg_s2: tuple[float, ...] = Field(description="of each axis")
    joint_jerk_limits_deg_s3: tuple[float | None, ...] | None = Field(
        default=None, description="of each axis; null, or not there: not limited"
    )
    speed_scaling: float = Field(description="fraction of the speeds that the motion was timed with")
    acceleration_scaling: float = Field(description="fraction of the accelerations and jerks")
    clearance_mm: float = Field(description="that everything keeps from everything else")
    arrival_mm: float | None = optional("how far a point of arm or tool may stand from where a move ends")
    plan: ResolvedPlan
    regions: tuple[ResolvedRegion, ...] | None = optional()

    @property
    def table_is_endless(self) -> bool:
        """Whether a rotary table turns round and round."""
        return self.table is not None and self.table.limits_deg is None
