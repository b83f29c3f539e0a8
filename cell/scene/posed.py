"""Poses of a scene file: position and KUKA's angles, the mount in three forms, the placement by centre or origin."""

from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from cell.scene.fields import Four, Table, Triple
from cell.scene.option import Option

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PART = "Part and place"
"""Heading of the options of part and placement."""

_PLACE = Option(
    "Where the part's centre stands in the robot's base frame (mm) and how it is turned (deg, KUKA ABC).",
    PART,
    name="place",
    metavar="X,Y,Z[,A,B,C]",
    form="x,y,z or x,y,z,A,B,C (mm and deg)",
    examples=("1200,500,0",),
    counts=(3, 6),
)

_PLACE_ORIGIN = Option(
    "In place of --place: where the origin of the part's file stands in base (mm), and how it is turned (deg).", PART,
    name="place_origin", metavar="X,Y,Z[,A,B,C]", form="x,y,z or x,y,z,A,B,C (mm and deg)", examples=("1200,500,-80",),
    counts=(3, 6),
)  # fmt: skip


class Posed(Table):
    """A pose: position x, y, z and angles A, B, C (R = Rz(A) Ry(B) Rx(C))."""

    position_mm: Triple = (0.0, 0.0, 0.0)
    abc_deg: Triple = (0.0, 0.0, 0.0)

    @property
    def T(self) -> "NDArray[np.float64]":  # the field's name for a transform
        """(4, 4) the pose as a transform [m]."""
        return pose(self.position_mm, self.abc_deg)


def pose(position_mm: tuple[float, float, float], abc_deg: tuple[float, float, float]) -> "NDArray[np.float64]":
    """(4, 4) transform [m] of a position [mm] and KUKA's angles A, B, C [deg]."""
    import numpy as np

    from cell.robot.frames import pose_from_kuka_abc

    return pose_from_kuka_abc(np.array(position_mm) / 1000.0, np.deg2rad(abc_deg))


class Mount(Posed):
    """The scanner frame (origin at the laser source, +z viewing direction, +x to the sensor) in the flange frame.

    The turn may be given as `quaternion` (w, x, y, z) in place of `abc_deg`, the whole as `matrix_mm`, four rows of
    four whose last column is the position.
    """

    position_mm: Triple = (0.0, 0.0, 120.0)
    quaternion: Four | None = None
    matrix_mm: Annotated[tuple[Four, Four, Four, Four], Field(strict=False)] | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.quaternion is not None or self.matrix_mm is not None:
            from cell.scene.turns import require_one_form

            require_one_form(self.quaternion, self.matrix_mm, self.model_fields_set)
        return self

    @property
    def T(self) -> "NDArray[np.float64]":  # the field's name for a transform
        """(4, 4) the mount as a transform [m]."""
        from cell.scene.turns import of_matrix, of_quaternion

        if self.matrix_mm is not None:
            return of_matrix(self.matrix_mm)
        return super().T if self.quaternion is None else of_quaternion(self.position_mm, self.quaternion)


class Placement(Table):
    """Where the middle of the part's bounding box stands in the robot's base frame, or the origin of its file."""

    position_mm: Annotated[Triple, _PLACE] = (1200.0, 500.0, 0.0)
    origin_mm: Annotated[Triple | None, _PLACE_ORIGIN] = None
    abc_deg: Annotated[Triple, _PLACE, _PLACE_ORIGIN] = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one_point(self) -> Self:
        if {"position_mm", "origin_mm"} <= self.model_fields_set and self.origin_mm is not None:
            raise ValueError(
                ".origin_mm is given beside position_mm; give where the file's origin or the centre stands"
            )
        return self

    @classmethod
    def at(cls, T_base_centre: "NDArray[np.float64]") -> Self:
        """The placement with the part's centre at a pose (4, 4) [m], its numbers without the dust of the conversion."""
        import numpy as np

        from cell.robot.frames import kuka_abc_from_pose

        position, abc = kuka_abc_from_pose(T_base_centre)
        numbers = (1000 * position).round(9) + 0.0, np.degrees(abc).round(9) + 0.0
        return cls(position_mm=tuple(numbers[0].tolist()), abc_deg=tuple(numbers[1].tolist()))

    @property
    def T(self) -> "NDArray[np.float64]":  # the field's name for a transform
        """(4, 4) the part's centre in base [m]; only of a placement by the centre (`by_centre`)."""
        assert self.origin_mm is None, "the placement is not settled"
        return pose(self.position_mm, self.abc_deg)

    def by_centre(self, T_object_centre: "NDArray[np.float64]") -> "Placement":
        """The same placement said by the part's centre, (4, 4) in the object frame [m]."""
        if self.origin_mm is None:
            return self
        middle = (1000 * (pose(self.origin_mm, self.abc_deg) @ T_object_centre)[:3, 3]).round(9) + 0.0
        return Placement(position_mm=tuple(middle.tolist()), abc_deg=self.abc_deg)
