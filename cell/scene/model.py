"""The scene: tables of a TOML file as one frozen `Scene`.

A scene describes the robot, the scanner and its mount, the part and its placement, the rotary table, the surroundings,
regions of the part, and how to plan. Every key has its unit (`_mm`, `_deg`); poses are x, y, z and KUKA's A, B, C.
A key with value None has the scanner's default (range, baseline, housing), the part's (planning faces), or follows from
another key (the standoff from the range, the housing's position from the baseline); `cell.scene.settle` fills it in.
`models/scene.toml` is the built-in scene with every key explained; `Scene()` equals it.

The keys of `[scanner]` are the arguments of the plug-in class that `type` names; a key of another type is an error. A
sensor of the library sets its type and its known figures; keys of the scene take precedence.

A face of the part belongs to the first `[[region]]` that selects it. A region without selectors is the rest.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails

from cell.errors import SceneError
from cell.part.formats import own_units, units_problem
from cell.scene import sensors
from cell.scene.features import FeatureTable, Inspection, feature_contradiction
from cell.scene.fields import (
    AxisLimits,
    Four,
    Fov,
    Grazing,
    JerkLimits,
    NotNegative,
    Positive,
    Share,
    Table,
    Triple,
    Units,
    existing_file,
    full_path,
)
from cell.scene.options import Option
from cell.scene.validation import did_you_mean

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


_ROTATION_TOLERANCE = 1e-3
"""Largest error of a given rotation: the rounding of numbers with four decimals. The rotation is then made exact."""

PART = "Part and place"
"""Heading of the options of part and placement."""

_PLACE = Option(
    "Pose of the part's centre in the robot's base frame: position (mm) and orientation (deg, KUKA ABC).",
    PART,
    name="place",
    metavar="X,Y,Z[,A,B,C]",
    form="x,y,z or x,y,z,A,B,C (mm and deg)",
    examples=("1200,500,0",),
    counts=(3, 6),
)

_PLACE_ORIGIN = Option(
    "Instead of --place: pose of the origin of the part's file in base (mm and deg).",
    PART,
    name="place_origin",
    metavar="X,Y,Z[,A,B,C]",
    form="x,y,z or x,y,z,A,B,C (mm and deg)",
    examples=("1200,500,-80",),
    counts=(3, 6),
)


class Posed(Table):
    """A pose: position x, y, z and angles A, B, C (R = Rz(A) Ry(B) Rx(C))."""

    position_mm: Triple = (0.0, 0.0, 0.0)
    abc_deg: Triple = (0.0, 0.0, 0.0)

    @property
    def T(self) -> "NDArray[np.float64]":
        """Transform (4, 4) of the pose [m]."""
        return pose(self.position_mm, self.abc_deg)


def pose(position_mm: tuple[float, float, float], abc_deg: tuple[float, float, float]) -> "NDArray[np.float64]":
    """Return the transform (4, 4) [m] of a position [mm] and KUKA's angles A, B, C [deg]."""
    import numpy as np

    from planner.kinematics.frames import pose_from_kuka_abc

    return pose_from_kuka_abc(np.array(position_mm) / 1000.0, np.deg2rad(abc_deg))


def pose_keys(T: "NDArray[np.float64]") -> dict[str, tuple[float, ...]]:
    """Return `position_mm` and `abc_deg` of a transform (4, 4) [m], rounded to recover the numbers of a scene."""
    import numpy as np

    from planner.kinematics.frames import kuka_abc_from_pose

    position, abc = kuka_abc_from_pose(T)
    keys = {"position_mm": (1000 * position).round(9) + 0.0, "abc_deg": np.degrees(abc).round(9) + 0.0}
    return {key: tuple(values.tolist()) for key, values in keys.items()}


class Mount(Posed):
    """The scanner frame (origin at the laser source, +z viewing direction, +x to the sensor) in the flange frame.

    `quaternion` (w, x, y, z) may replace `abc_deg`. `matrix_mm`, four rows of four with the position as last column,
    may replace the whole pose.
    """

    position_mm: Triple = (0.0, 0.0, 120.0)
    quaternion: Four | None = None
    matrix_mm: Annotated[tuple[Four, Four, Four, Four], Field(strict=False)] | None = None

    @model_validator(mode="after")
    def _one_valid_form(self) -> Self:
        if self.quaternion is None and self.matrix_mm is None:
            return self
        import numpy as np  # the start-up of the command line does without it

        replaced = {"matrix_mm": ("position_mm", "abc_deg", "quaternion"), "quaternion": ("abc_deg",)}
        for key, alternatives in replaced.items():
            if getattr(self, key) is not None and (
                conflicts := [each for each in alternatives if each in self.model_fields_set]
            ):
                raise ValueError(f".{key} is given together with {conflicts[0]}; give the pose in one form")
        if self.quaternion is not None and abs(float(np.linalg.norm(self.quaternion)) - 1) > _ROTATION_TOLERANCE:
            raise ValueError(
                f".quaternion has the length {np.linalg.norm(self.quaternion):.4g}; it must be 1 (w, x, y, z)"
            )
        if self.matrix_mm is not None:
            T = np.array(self.matrix_mm)
            R = T[:3, :3]
            if np.abs(T[3] - [0, 0, 0, 1]).max() > 0:
                raise ValueError(
                    ".matrix_mm has another last row than 0, 0, 0, 1; give four rows of a transform, positions in mm"
                )
            if np.abs(R @ R.T - np.eye(3)).max() > _ROTATION_TOLERANCE or np.linalg.det(R) < 0:
                raise ValueError(".matrix_mm holds no rotation (orthogonal rows of length 1, right-handed)")
        return self

    @property
    def T(self) -> "NDArray[np.float64]":
        """Transform (4, 4) of the mount [m]."""
        if self.matrix_mm is None and self.quaternion is None:
            return super().T
        import numpy as np
        from scipy.spatial.transform import Rotation

        T = np.eye(4)
        if self.matrix_mm is not None:
            matrix = np.array(self.matrix_mm, dtype=np.float64)
            T[:3, :3], T[:3, 3] = Rotation.from_matrix(matrix[:3, :3]).as_matrix(), matrix[:3, 3] / 1000
        elif self.quaternion is not None:
            rotation = Rotation.from_quat(self.quaternion, scalar_first=True)
            T[:3, :3], T[:3, 3] = rotation.as_matrix(), np.array(self.position_mm) / 1000
        return T


class Placement(Table):
    """Pose of the middle of the part's bounding box in the robot's base frame, or of the origin of its file."""

    position_mm: Annotated[Triple, _PLACE] = (1200.0, 500.0, 0.0)
    origin_mm: Annotated[Triple | None, _PLACE_ORIGIN] = None
    abc_deg: Annotated[Triple, _PLACE, _PLACE_ORIGIN] = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one_point(self) -> Self:
        if {"position_mm", "origin_mm"} <= self.model_fields_set and self.origin_mm is not None:
            raise ValueError(
                ".origin_mm is given together with position_mm; give the pose of the file's origin or of the centre"
            )
        return self

    @classmethod
    def at(cls, T_base_centre: "NDArray[np.float64]") -> Self:
        """Return the placement with the part's centre at a pose (4, 4) [m]."""
        return cls.model_validate(pose_keys(T_base_centre))

    @property
    def T(self) -> "NDArray[np.float64]":
        """Pose (4, 4) of the part's centre in base [m], of a settled placement (`by_centre`)."""
        assert self.origin_mm is None, "the placement is not settled"
        return pose(self.position_mm, self.abc_deg)

    def by_centre(self, T_object_centre: "NDArray[np.float64]") -> "Placement":
        """Return the same placement by the part's centre, (4, 4) in the object frame [m]."""
        if self.origin_mm is None:
            return self
        middle = (1000 * (pose(self.origin_mm, self.abc_deg) @ T_object_centre)[:3, 3]).round(9) + 0.0
        return Placement(position_mm=tuple(middle.tolist()), abc_deg=self.abc_deg)


RESERVED_NAMES = (
    *("base", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6"),
    *("bracket", "housing", "part", "object", "post", "pedestal", "floor", "world"),
)


class NamedFixture(Posed):
    """Keys of every fixture."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ .-]*$", max_length=100)]  # it names a file
    attached_to: Literal["base", "object"] = "base"
    occludes: bool = True

    @field_validator("name")
    @classmethod
    def _not_reserved(cls, name: str) -> str:
        if name in RESERVED_NAMES:
            raise ValueError(f"is '{name}', which is the name of a shape of the cell; choose another name")
        return name


class BoxFixture(NamedFixture):
    """A box, `position_mm` at its middle."""

    shape: Literal["box"]
    size_mm: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]


class CylinderFixture(NamedFixture):
    """An upright cylinder (axis z), `position_mm` at its middle; size is diameter and height."""

    shape: Literal["cylinder"]
    size_mm: Annotated[tuple[Positive, Positive], Field(strict=False)]


class MeshFixture(NamedFixture):
    """A mesh file: its triangles occlude, and collide unless `plan.collision` is "hull"."""

    shape: Literal["mesh"]
    path: str
    units: Units

    @model_validator(mode="before")
    @classmethod
    def _of_its_format(cls, table: Any) -> Any:
        units = own_units(str(table.get("path"))) if isinstance(table, dict) else None
        return {"units": units, **table} if units is not None else table

    @field_validator("path")
    @classmethod
    def _found(cls, path: str, info: ValidationInfo) -> str:
        return existing_file(path, info)

    @field_validator("units")
    @classmethod
    def _given_for_a_file_without(cls, units: str, info: ValidationInfo) -> str:
        if why := units_problem(path := info.data.get("path", ""), units):
            raise ValueError(f"is given for {path}, which {why}")
        return units


Fixture = Annotated[BoxFixture | CylinderFixture | MeshFixture, Field(discriminator="shape")]


class Post(Table):
    """The round post below the part, from the floor to the part's lowest point."""

    enabled: bool = True
    diameter_mm: Positive = 40.0


class Setup(Posed):
    """A pose of the part's centre that `cell setups` may use, and the fixtures and post of this set-up alone."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ .-]*$", max_length=100)]
    position_mm: Triple
    fixtures: Annotated[tuple[Fixture, ...], Field(strict=False)] = ()
    post: Post | None = None


class Turntable(Table):
    """The rotary table below the post: it turns part, post and the part's fixtures about its z (docs/table.md).

    `position_mm` is the middle of its face, `abc_deg` the orientation of its frame, 0 for an upright axis. Without a
    position the axis goes through the part's centre, and the face is `post_mm` below the part's lowest point along the
    axis; with one, the post is as long as the part is above the face. A `[table]` with any key is enabled unless it
    says `enabled = false`. Without limits it is endless, and used half a turn to either side of 0, where motions
    begin and end. It moves together with the arm; an indexed table turns only while the arm is still and clear of
    everything that turns.
    """

    enabled: Annotated[
        bool, Option("Turn the part on the scene's rotary table, or on the default one.", PART, name="table")
    ] = False
    position_mm: Triple | None = None
    abc_deg: Triple = (0.0, 0.0, 0.0)
    diameter_mm: Positive = 400.0
    height_mm: Positive = 250.0
    post_mm: Positive = 300.0
    swing_mm: Positive = 1000.0
    limits_deg: Annotated[tuple[float, float], Field(strict=False)] | None = None
    velocity_deg_s: Positive = 120.0
    acceleration_deg_s2: Positive = 240.0
    jerk_deg_s3: Positive = 2400.0
    moves: Literal["synchronised", "indexed"] = "synchronised"
    angles: Annotated[int, Field(ge=1, le=360)] = 36

    @model_validator(mode="before")
    @classmethod
    def _enabled_by_its_keys(cls, table: Any) -> Any:
        return {"enabled": True, **table} if isinstance(table, dict) and table else table

    @field_validator("limits_deg")
    @classmethod
    def _about_home(cls, limits: tuple[float, float] | None) -> tuple[float, float] | None:
        if limits is not None and not limits[0] <= 0.0 <= limits[1]:
            raise ValueError(f"is {list(limits)}; it must be [min, max] around 0, where motions begin and end")
        return limits


HARDWARE = "Robot and scanner"
"""Heading of the options of robot and scanner."""


class Base(Posed):
    """Pose of the robot's base in the frame of the cell, with z up."""


class Robot(Table):
    """The arm, its base and its speed limits.

    Without `base` the cell's frame is the robot's base. The floor is `pedestal_height_mm` below the cell's origin; an
    upright base has a pedestal on it, any other base has none.
    """

    model: str = "kr16"
    base_link: str | None = None
    flange_link: str | None = None
    packages: dict[str, str] | None = None
    base: Base | None = None
    home_deg: Annotated[tuple[float, float, float, float, float, float], Field(strict=False)] | None = None
    pedestal_height_mm: NotNegative = 600.0
    pedestal_size_mm: Annotated[tuple[Positive, Positive], Field(strict=False)] = (600.0, 600.0)
    speed_scaling: Annotated[
        Share, Option("Override: share of the axis speeds.", HARDWARE, name="speed", metavar="SHARE")
    ] = 1.0
    acceleration_scaling: Share = 1.0
    velocity_deg_s: Annotated[AxisLimits, Field(strict=False)] | None = None
    acceleration_deg_s2: Annotated[AxisLimits, Field(strict=False)] | None = None
    jerk_deg_s3: Annotated[JerkLimits, Field(strict=False)] | None = None

    @field_validator("model")
    @classmethod
    def _known(cls, model: str, info: ValidationInfo) -> str:
        return model if model == "kr16" else existing_file(model, info, "a URDF or an MJCF, or kr16")

    @field_validator("packages")
    @classmethod
    def _folders(cls, packages: dict[str, str] | None, info: ValidationInfo) -> dict[str, str] | None:
        return packages and {name: str(full_path(path, info)) for name, path in packages.items()}

    _name: str = PrivateAttr("")

    @property
    def name(self) -> str:
        """Name of the model's file, of the original one for a run's copy; or kr16."""
        return self._name or Path(self.model).name

    def with_name(self, name: str) -> Self:
        """Return the same robot with the name of the original file."""
        robot = self.model_copy()
        robot._name = name
        return robot

    @property
    def settled_home_deg(self) -> tuple[float, ...]:
        """Home of a compiled scene (`cell.world.model`) [deg]."""
        assert self.home_deg is not None, "the scene is not settled"
        return self.home_deg

    @property
    def T_base(self) -> "NDArray[np.float64]":
        """Pose (4, 4) of the robot's base in the cell's frame [m]."""
        return (self.base or Base()).T

    @property
    def pedestal_mm(self) -> tuple[Triple, Triple] | None:
        """Sides and middle of the pedestal in the cell's frame [mm]; None: no pedestal."""
        x, y, z = (0.0, 0.0, 0.0) if self.base is None else self.base.position_mm
        height = self.pedestal_height_mm + z
        if height <= 0 or not self.T_base[2, 2] > 1 - 1e-9:
            return None
        return (*self.pedestal_size_mm, height), (x, y, z - height / 2)


_VIEWS, _REQUESTS = "Views", "Coverage requests (docs/coverage_requests.md)"
_Candidates = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(strict=False)]
_PIN, _BAN = (
    Option(text, _REQUESTS, name, metavar="ID[,ID...]", form="candidates by their numbers", examples=("12,40",))
    for name, text in (("pin", "Candidates that the plan must use."), ("ban", "Candidates that it must not use."))
)
_OVERLAP = Option(
    "Connect all scans: two views overlap if they share this part of the area of the smaller one, or this area.",
    _REQUESTS,
    metavar="SHARE%|AREAmm2",
    form="a share of the smaller view or an area",
    examples=("20%", "500mm2"),
)
_POSE_SD = Option(
    "Standard deviations of executed poses: a sample counts if the plan measures it with probability 1 - alpha.",
    _REQUESTS,
    metavar="MMmm,DEGdeg",
    form="standard deviations of position and orientation with their units",
    examples=("0.5mm,0.1deg",),
)


class PlanKeys(Table):
    """Keys of `[plan]`; None is the part's default."""

    candidates: Annotated[
        Literal["grown", "optimal-scanning-zone", "view-sphere"],
        Option("Candidate viewpoints: one per face, and others where these fail; or those of the paper.", _VIEWS),
    ] = "grown"
    view_sphere_step_deg: Annotated[
        tuple[Annotated[float, Field(gt=0, le=180)], Annotated[float, Field(gt=0, le=180)]], Field(strict=False)
    ] = (15.0, 15.0)
    standoffs_mm: Annotated[
        Annotated[tuple[Positive, ...], Field(strict=False, min_length=1)] | None,
        Option("Distances from surface to laser source. Default: the middle of the range.", _VIEWS, name="standoff"),
    ] = None
    rolls_deg: Annotated[
        tuple[float, ...],
        Field(strict=False, min_length=1),
        Option("Rolls about the viewing axis.", _VIEWS, name="roll"),
    ] = (0.0, 90.0)
    faces: Annotated[
        int | None,
        Field(ge=4),
        Option("Faces of the planning mesh (one candidate normal each). Default: the part's.", _VIEWS),
    ] = None
    percent_kept: Annotated[
        float | None,
        Field(gt=0, le=100),
        Option("Instead of --faces: percentage of the faces that is KEPT.", _VIEWS, "percent", metavar="PERCENT"),
    ] = None
    samples_per_face: Annotated[
        int, Field(ge=1), Option("Surface samples per planning face (fill aimed).", _VIEWS, name="samples")
    ] = 4
    fill: Annotated[Literal["aimed", "rays"], Option("Method that fills the measurability matrix.", _VIEWS)] = "aimed"
    solver: Annotated[
        Literal["auto", "greedy", "meta-raps", "local-search", "exact"],
        Option("Selection of the views; auto proves the smallest number if it can.", _VIEWS),
    ] = "auto"
    effort: Annotated[
        str,
        BeforeValidator(lambda value: str(value) if type(value) is int else value),
        Field(pattern=r"^(low|normal|high|\d+)$"),
        Option(
            "Effort of the search for fewer views over all reachable poses: a word, or a number of poses.",
            _VIEWS,
            metavar="low|normal|high|POSES",
            form="a word or a number of poses",
            examples=("high", "200000"),
        ),
    ] = "normal"
    coverage: Annotated[
        Share, Option("Share of the coverable area that the plan must measure.", _VIEWS, metavar="SHARE")
    ] = 0.99
    required_visible: Annotated[
        float,
        Field(ge=0, le=1),
        Option(
            "Exit with code 3 when the predicted visible coverage of the WHOLE surface is below this share.",
            _VIEWS,
            name="require",
            metavar="SHARE",
        ),
    ] = 0.0
    max_sigma_mm: Annotated[
        Positive | None,
        Option("Count a point as measured only if its expected standard deviation is at most this.", _VIEWS),
    ] = None
    collision: Annotated[
        Literal["hull", "exact"],
        Option("Shapes of part and mesh fixtures in collision checks: convex hulls, or exact triangles.", _VIEWS),
    ] = "exact"
    seed: Annotated[int, Field(ge=0, le=2**63 - 1), Option("Seed of every random choice.", _VIEWS)] = 0
    max_views: Annotated[
        int | None, Field(ge=1), Option("Maximise the coverage with at most this number of views.", _REQUESTS)
    ] = None
    multiplicity: Annotated[
        int, Field(ge=1), Option("Measure each sample from at least this number of views.", _REQUESTS)
    ] = 1
    pinned: Annotated[_Candidates, _PIN] = ()
    banned: Annotated[_Candidates, _BAN] = ()
    cost: Annotated[
        Literal["views", "time"],
        Option("Cost of a view: 1, or time (scan, settling and an estimated move, in seconds).", _REQUESTS),
    ] = "views"
    scan_s: NotNegative = 2.0
    settle_s: NotNegative = 0.5
    overlap_mm2: Annotated[Positive | None, _OVERLAP] = None
    overlap_share: Annotated[Share | None, _OVERLAP] = None
    overlap_in_order: Annotated[bool, Option("Each view overlaps an earlier one.", _REQUESTS)] = False
    pose_sd_mm: Annotated[NotNegative, _POSE_SD] = 0.0
    pose_sd_deg: Annotated[NotNegative, _POSE_SD] = 0.0
    alpha: Annotated[
        float,
        Field(gt=0, lt=1),
        Option("With --pose-sd: probability of missing a sample that counts.", _REQUESTS, metavar="SHARE"),
    ] = 0.05
    ensemble: Annotated[int, Field(ge=1, le=10_000)] = 32
    curve: Annotated[bool, Option("Also compute coverage over the number of views, with bounds.", _REQUESTS)] = False


_SELECTION_KEYS = (
    *("max_views", "multiplicity", "cost", "overlap_mm2", "overlap_share", "overlap_in_order"),
    *("pose_sd_mm", "pose_sd_deg", "curve", "solver"),
)
_ORDER_KEYS = ("overlap_mm2", "overlap_share", "overlap_in_order")


class PlanSettings(PlanKeys):
    """The `[plan]` table: keys that are consistent with each other."""

    def without_selection(self) -> Self:
        """Return the settings with default requests of the selection, for views that are selected elsewhere."""
        return self.model_copy(update={key: PlanKeys.model_fields[key].default for key in _SELECTION_KEYS})

    def with_views(self, views: Sequence[int], n_candidates: int) -> Self:
        """Return settings that select exactly these of the candidates."""
        banned = tuple(sorted(set(range(n_candidates)).difference(views)))
        return self.without_selection().model_copy(update={"coverage": 1.0, "pinned": tuple(views), "banned": banned})

    def with_order_of(self, other: Self) -> Self:
        """Return the settings with the overlap of other ones, if the order of visits has to keep it."""
        if not other.overlap_in_order:
            return self
        return self.model_copy(update={key: getattr(other, key) for key in _ORDER_KEYS})

    @field_validator("percent_kept")
    @classmethod
    def _one_size(cls, percent: float | None, info: ValidationInfo) -> float | None:
        if percent is not None and info.data.get("faces") is not None:
            raise ValueError("and plan.faces both set the size of the planning mesh; give one of them")
        return percent

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if problem := _plan_contradiction(self):
            raise ValueError(f".{problem}")
        return self


def _plan_contradiction(plan: PlanSettings) -> str:
    """Return the first contradiction between keys, beginning with a key of `[plan]`; "" for none."""
    overlap = "overlap_mm2" if plan.overlap_mm2 is not None else "overlap_share"
    has_overlap = plan.overlap_mm2 is not None or plan.overlap_share is not None
    has_errors = plan.pose_sd_mm > 0 or plan.pose_sd_deg > 0
    if plan.overlap_mm2 is not None and plan.overlap_share is not None:
        return "overlap_mm2 and plan.overlap_share both define an overlap; give one of them"
    if both := sorted(set(plan.pinned) & set(plan.banned)):
        return f"pinned and plan.banned both name candidate {both[0]}; remove it from one of them"
    requests = {
        "max_views": plan.max_views is not None,
        "multiplicity": plan.multiplicity > 1,
        overlap: has_overlap,
        "pose_sd_mm" if plan.pose_sd_mm > 0 else "pose_sd_deg": has_errors,
        "cost": plan.cost == "time",
    }
    keys = [key for key, is_given in requests.items() if is_given]
    if len(keys) > 1 and keys != ["multiplicity", "cost"]:
        return f"{keys[0]} and plan.{keys[1]} cannot be combined; give one of them"
    if plan.max_views is not None and plan.coverage < 1 and "coverage" in plan.model_fields_set:
        return "max_views and plan.coverage both limit the plan; give one of them"
    if plan.max_views is not None and len(plan.pinned) > plan.max_views:
        return f"max_views is {plan.max_views} and {len(plan.pinned)} views are pinned; allow more or pin fewer"
    if keys and keys[0] not in ("multiplicity", "cost") and plan.solver != "auto":
        return f"solver is '{plan.solver}', and plan.{keys[0]} has its own search; use the solver 'auto'"
    if plan.overlap_in_order and not has_overlap:
        return "overlap_in_order needs an overlap; give plan.overlap_mm2 or plan.overlap_share"
    if has_errors and plan.fill == "rays":
        return "pose_sd_mm and pose_sd_deg need aimed samples; choose plan.fill = 'aimed'"
    return ""


REST = "the rest"
"""Name of the surface that no region selects."""

_SELECTORS = ("faces", "kind", "diameter_below_mm", "diameter_above_mm", "box_mm", "colour", "painted")
_REGION_TARGETS = ("coverage", "max_sigma_mm", "max_spacing_mm", "views", "weight")


class RegionTargets(Table):
    """Targets of a region; None is the target of the plan."""

    name: Annotated[str, Field(min_length=1, max_length=60, description="unique")]
    care: Annotated[Literal["yes", "no"], Field(description="no: not measured, an obstacle only")] = "yes"
    coverage: Annotated[
        Share | None, Field(description="share of its coverable area; without one it counts with the other regions")
    ] = None
    max_sigma_mm: Annotated[Positive | None, Field(description="largest standard deviation of a point")] = None
    max_spacing_mm: Annotated[Positive | None, Field(description="largest distance of neighbouring points")] = None
    views: Annotated[int | None, Field(ge=1, description="number of views that measure each sample")] = None
    weight: Annotated[Positive, Field(description="of its area relative to other regions")] = 1.0

    @property
    def is_measured(self) -> bool:
        """Whether the region has to be measured."""
        return self.care == "yes"


class Region(RegionTargets):
    """A `[[region]]` of the scene file: the faces for which all its selectors hold, and their targets."""

    faces: Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(strict=False, min_length=1)] | None = None
    kind: Literal["plane", "cylinder", "cone", "sphere", "torus", "other"] | None = None
    diameter_below_mm: Positive | None = None
    diameter_above_mm: NotNegative | None = None
    box_mm: Annotated[tuple[float, float, float, float, float, float], Field(strict=False)] | None = None
    colour: Annotated[str, Field(pattern=r"^#[0-9A-Fa-f]{6}$")] | None = None
    painted: str | None = None
    painted_units: Units | None = None

    @property
    def selects(self) -> bool:
        """Whether it has a selector; a region without one is the rest."""
        return any(getattr(self, key) is not None for key in _SELECTORS)

    @field_validator("name")
    @classmethod
    def _one_line(cls, name: str) -> str:
        if not name.isprintable() or "|" in name or name != name.strip():
            raise ValueError(
                f"is {name!r}; it must be one line without '|', and without a blank at its beginning or end"
            )
        return name

    @field_validator("box_mm")
    @classmethod
    def _low_and_high(cls, box: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if box is not None and not all(low < high for low, high in zip(box[:3], box[3:], strict=True)):
            raise ValueError(f"is {list(box)}; it must be x, y, z of its lowest corner, then of its highest")
        return box

    @field_validator("painted")
    @classmethod
    def _found(cls, painted: str | None, info: ValidationInfo) -> str | None:
        return None if painted is None else existing_file(painted, info, "a coloured mesh")

    @model_validator(mode="after")
    def _consistent(self) -> "Region":
        targets = [key for key in _REGION_TARGETS if key in self.model_fields_set and getattr(self, key) is not None]
        if not self.is_measured and targets:
            raise ValueError(f".care is 'no', and region.{targets[0]} is a target; give one of them")
        if self.painted is not None and self.colour is None:
            raise ValueError(".painted needs region.colour, the colour that marks the region in it, as '#rrggbb'")
        if self.painted is not None and self.painted_units is None and own_units(self.painted) is None:
            raise ValueError(".painted needs region.painted_units: mm, cm, m, um or in")
        below, above = self.diameter_below_mm, self.diameter_above_mm
        if below is not None and above is not None and not above < below:
            raise ValueError(f".diameter_above_mm is {above:g}, which is not below region.diameter_below_mm, {below:g}")
        return self


def _region_contradiction(regions: Sequence[Region], plan: PlanSettings | None) -> str:
    """Return the first contradiction between regions, or with the plan, as a predicate of the key `region`."""
    names = [region.name for region in regions]
    if twice := next((name for name in names if names.count(name) > 1), ""):
        return f"holds the name '{twice}' more than once; every region needs its own"
    for region in regions[:-1]:
        if not region.selects:
            return f"holds '{region.name}', which has no selector and selects all the rest; put it last"
    if regions and REST in names and regions[-1].selects:
        return f"holds the name '{REST}', which is reserved for the surface that no region selects; choose another"
    if regions and not any(region.is_measured for region in regions) and not regions[-1].selects:
        return 'measures nothing, since every region has care = "no"; remove care from the regions to be measured'
    if not regions or plan is None:
        return ""
    if plan.fill == "rays":
        return "needs aimed samples; choose plan.fill = 'aimed'"
    requests = {
        "max_views": plan.max_views is not None,
        "overlap": plan.overlap_mm2 is not None or plan.overlap_share is not None,
        "pose_sd": plan.pose_sd_mm > 0 or plan.pose_sd_deg > 0,
    }
    request = next((key for key, is_given in requests.items() if is_given), "")
    for region in regions:
        for key in ("coverage", "views", "weight"):
            if request and key in region.model_fields_set and (request, key) != ("max_views", "weight"):
                return f"'{region.name}' has the target {key}, which plan.{request} excludes; give one of them"
    return ""


def require_no_region_targets(regions: Sequence[Region]) -> None:
    """Refuse regions with targets: studies know only whether a region is measured.

    Raises:
        SceneError: with the region and the key.
    """
    for region in regions:
        for key in _REGION_TARGETS:
            if key in region.model_fields_set:
                raise SceneError(
                    f"the region '{region.name}' has the target {key}, and studies support only the key care; omit it"
                )


def with_rest(regions: Sequence[Region]) -> tuple[Region, ...]:
    """Return the regions followed by the rest, if none of them is the rest; none if the scene has none."""
    rest = () if not regions or not regions[-1].selects else (Region(name=REST),)
    return (*regions, *rest)


_COMMON_SCANNER_KEYS = ("type", "sensor")
_RAY_GRID_KEY = "planning_resolution_deg"
"""Replaces `resolution_deg` if the matrix is filled by scanning: a key of every type with a resolution."""


def scanner_keys(kind: str) -> tuple[str, ...] | None:
    """Return the valid keys of a `[scanner]` table of a type; None if its class takes any key.

    Raises:
        SceneError: if the plug-in cannot be imported; the message names its distribution.
    """
    from cell import scanners

    type_keys = scanners.keys(kind)
    if type_keys is None:
        return None
    return (*_COMMON_SCANNER_KEYS, *type_keys, *((_RAY_GRID_KEY,) if "resolution_deg" in type_keys else ()))


def _fill_in_sensor(content: dict[str, object]) -> list[InitErrorDetails]:
    """Fill in the figures of the sensor's file; return the problems."""
    name = content.get("sensor")
    if not isinstance(name, str):
        return []
    try:
        sensor = sensors.load(name)
    except SceneError:
        known = sensors.names()
        return [_problem("sensor", name, f"is '{name}'; {did_you_mean(name, known)}valid are: {', '.join(known)}")]
    if content.get("type", sensor.type) != sensor.type:
        return [_problem("type", content["type"], f"is '{content['type']}', and {name} is a {sensor.type}; omit type")]
    for key, value in {"type": sensor.type, **sensor.keys}.items():
        content.setdefault(key, value)
    needed = dict(sensor.not_stated)
    if sensor.type == "laser-line" and {"max_spacing_mm", "profile_rate_hz"} & set(content):
        needed |= sensors.DENSITY_KEYS
    return [
        _problem("sensor", name, f"{name} does not state its {word}; set scanner.{key}")
        for key, word in needed.items()
        if key not in content
    ]


def _remove_foreign_keys(content: dict[str, object], kind: str) -> list[InitErrorDetails]:
    """Remove keys that the type does not have; return a problem for each."""
    known = scanner_keys(kind)
    problems = []
    for key in [key for key in content if known is not None and key not in known]:
        hint = did_you_mean(key, known or ())
        text = f"is an unknown key of {kind}; {hint}valid are: {', '.join(known or ())}"
        problems.append(_problem(key, content.pop(key), text))
    return problems


def _problem(key: str, value: object, text: str) -> InitErrorDetails:
    return {"type": "value_error", "loc": (key,), "input": value, "ctx": {"error": ValueError(text)}}


def _reraisable(detail: ErrorDetails) -> InitErrorDetails:
    """Convert an error of pydantic to the form in which it can be raised again."""
    error: InitErrorDetails = {"type": detail["type"], "loc": detail["loc"], "input": detail["input"]}
    if "ctx" in detail:
        error["ctx"] = detail["ctx"]
    return error


_CELL_OBJECTS = ("robot", "scanner", "post", "pedestal", "floor")

_REPORT = "Output"


class Scanner(Table):
    """The sensor model; keys of third-party plug-ins are extra fields."""

    model_config = ConfigDict(extra="allow")  # `_keys_of_its_type` refuses unknown keys

    type: str = "laser-area"
    sensor: Annotated[
        str | None, Option("Scanner by name, see cell sensors. Default: the part's device.", HARDWARE)
    ] = None
    fov_deg: Annotated[tuple[Fov, Fov], Field(strict=False)] = (60.0, 60.0)
    resolution_deg: Annotated[tuple[Positive, Positive], Field(strict=False)] = (0.25, 0.25)
    planning_resolution_deg: Positive = 1.0
    range_mm: Annotated[tuple[NotNegative, Positive], Field(strict=False)] | None = None
    baseline_mm: Annotated[
        NotNegative | None, Option("Distance from laser source to sensor. Default: the scanner's.", HARDWARE)
    ] = None
    grazing_max_deg: Grazing = 75.0
    sensor_grazing_max_deg: Grazing = 75.0
    sensor_fov_deg: Annotated[tuple[Fov, Fov], Field(strict=False)] | None = None
    sensor_tilt_deg: Annotated[float, Field(gt=-90, lt=90)] | None = None
    depth_of_field_mm: Annotated[tuple[NotNegative, Positive], Field(strict=False)] | None = None
    sigma_angle_mdeg: NotNegative = 1.5
    fan_deg: Fov = 28.0
    sweep_mm: Positive | None = None
    sweep_deg: Fov | None = None
    sweep_steps: Annotated[int, Field(ge=1)] = 8
    line_points: Annotated[int, Field(ge=1)] = 640
    profile_rate_hz: Positive | None = None
    max_spacing_mm: Annotated[
        Positive | None,
        Option("Count a point as measured only if its neighbours in the scan are at most this far away.", HARDWARE),
    ] = None

    @model_validator(mode="wrap")
    @classmethod
    def _keys_of_its_type(cls, table: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Fill in the sensor, and report unknown keys together with the other problems."""
        from cell import scanners  # loads numpy

        if not isinstance(table, dict):
            return handler(table)
        content = {key: value for key, value in table.items() if value is not None}
        problems = _fill_in_sensor(content)
        kind = content.get("type", cls.model_fields["type"].default)
        if kind in scanners.names():
            problems += _remove_foreign_keys(content, kind)
        result: Self | None = None
        try:
            result = handler(content)
        except ValidationError as error:
            problems += [_reraisable(detail) for detail in error.errors()]
        if problems or result is None:
            raise ValidationError.from_exception_data("Scanner", problems)
        return result

    @field_validator("type")
    @classmethod
    def _installed(cls, name: str) -> str:
        from cell import scanners

        known = scanners.names()
        if name not in known:
            raise ValueError(f"is '{name}'; {did_you_mean(name, known)}installed are: {', '.join(known) or 'none'}")
        return name

    @field_validator("range_mm", "depth_of_field_mm")
    @classmethod
    def _ordered(cls, limits: tuple[float, float] | None) -> tuple[float, float] | None:
        if limits is not None and not limits[0] < limits[1]:
            raise ValueError(f"is {list(limits)}; it must be [min, max] with min < max")
        return limits

    @property
    def opening_deg(self) -> tuple[float, float]:
        """Opening angles [deg] for outlines and pictures: the field of view, or the thin fan of a line sensor."""
        from cell import scanners

        known = scanners.keys(self.type) or ()
        return (0.5, self.fan_deg) if "fan_deg" in known and "fov_deg" not in known else self.fov_deg


class Housing(Table):
    """The scanner's body, a box, and the bracket between it and the flange.

    Without `position_mm` the box is centred over the baseline (x) and the viewing axis (y), with its front face in the
    plane of the source, so that no ray starts inside it.
    """

    size_mm: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)] | None = None
    position_mm: Triple | None = None
    abc_deg: Triple = (0.0, 0.0, 0.0)
    bracket_diameter_mm: NotNegative | None = None

    @property
    def sides_mm(self) -> Triple:
        """Size in a settled scene."""
        assert self.size_mm is not None, "the scene is not settled"
        return self.size_mm

    @property
    def bracket_mm(self) -> float:
        """Diameter of the bracket in a settled scene."""
        assert self.bracket_diameter_mm is not None, "the scene is not settled"
        return self.bracket_diameter_mm

    def T_scanner_housing(self, baseline_mm: float) -> "NDArray[np.float64]":
        """Return the middle of the box (4, 4) in the scanner frame [m]."""
        return pose(self.position_mm or (baseline_mm / 2, 0.0, -self.sides_mm[2] / 2), self.abc_deg)


class Part(Table):
    """The part: a built-in one by `name`, or a file, with its units if the file does not state them."""

    name: Literal["mseke", "mug", "robinet", "petanque", "humerus", "st-jean"] = "mseke"
    path: str | None = None
    units: Annotated[
        Units | None, Field(validate_default=True), Option("Unit of the mesh file. Never guessed.", PART)
    ] = None

    @field_validator("path")
    @classmethod
    def _found(cls, path: str | None, info: ValidationInfo) -> str | None:
        return None if path is None else existing_file(path, info)

    @field_validator("units")
    @classmethod
    def _given_for_a_file(cls, units: str | None, info: ValidationInfo) -> str | None:
        path = info.data.get("path", "given, but wrong")
        if path is not None and (why := units_problem(path, units)):
            raise ValueError(f"is given for {path}, which {why}")
        if path is not None and units is None:
            if (file_units := own_units(path)) is not None:
                return file_units
            raise ValueError("is missing; give the unit of the file: mm, cm, m, um or in")
        if path is None and units is not None:
            raise ValueError("is given for a built-in part, which has its own size; omit it, or give part.path")
        return units

    @property
    def source(self) -> str:
        """Path of the file, or name of the built-in part."""
        return self.path if self.path is not None else self.name


class Picture(Table):
    """View of the cell in the report (cell.png); the plan does not depend on it."""

    camera_deg: Annotated[
        tuple[float, float] | None,
        Field(strict=False),
        Option(
            "Camera of the report's picture of the cell: azimuth and elevation as seen from the part, deg. Default: "
            "beside part and arm.",
            _REPORT,
            metavar="AZ,EL",
            form="azimuth,elevation (deg)",
            examples=("-60,20",),
            counts=(2,),
        ),
    ] = None
    hide: Annotated[
        tuple[str, ...],
        Field(strict=False),
        Option(
            "Objects that this picture leaves out: fixtures, robot, scanner, post, pedestal or floor.",
            _REPORT,
            metavar="NAME[,NAME...]",
            convert=lambda texts: [each for text in texts for each in text.split(",")],
        ),
    ] = ()


class Scene(Table):
    """A scene; `Scene()` is the built-in one."""

    clearance_mm: Annotated[NotNegative, Field(le=1000.0)] = 10.0
    arrival_mm: Positive | None = None
    path_tolerance_mm: Positive | None = None
    robot: Robot = Field(default_factory=Robot)
    scanner: Scanner = Field(default_factory=Scanner)
    mount: Mount = Field(default_factory=Mount)
    housing: Housing = Field(default_factory=Housing)
    part: Part = Field(default_factory=Part)
    placement: Placement = Field(default_factory=Placement)
    post: Post = Field(default_factory=Post)
    table: Turntable = Field(default_factory=Turntable)
    fixtures: Annotated[tuple[Fixture, ...], Field(strict=False)] = ()
    plan: PlanSettings = Field(default_factory=PlanSettings)
    region: Annotated[tuple[Region, ...], Field(strict=False)] = ()
    setup: Annotated[tuple[Setup, ...], Field(strict=False)] = ()
    feature: Annotated[tuple[FeatureTable, ...], Field(strict=False)] = ()
    inspection: Inspection = Field(default_factory=Inspection)
    picture: Picture = Field(default_factory=Picture)

    @property
    def has_features(self) -> bool:
        """Whether the scene or its QIF file defines features."""
        return bool(self.feature) or self.inspection.qif is not None

    def require_fixed_part(self, feature: str) -> None:
        """Refuse a rotary table for a feature that does not support it.

        Raises:
            SceneError: naming the feature.
        """
        if self.table.enabled:
            raise SceneError(f"{feature} does not support a rotary table yet; omit --table and [table]")

    @field_validator("fixtures")
    @classmethod
    def _distinct(cls, fixtures: tuple[NamedFixture, ...]) -> tuple[NamedFixture, ...]:
        names = [fixture.name for fixture in fixtures]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"hold the name '{twice[0]}' more than once; every fixture needs its own name")
        return fixtures

    @field_validator("region")
    @classmethod
    def _consistent(cls, regions: tuple[Region, ...], info: ValidationInfo) -> tuple[Region, ...]:
        if problem := _region_contradiction(regions, info.data.get("plan")):
            raise ValueError(problem)
        return regions

    @field_validator("feature")
    @classmethod
    def _has_known_datums(cls, features: tuple[FeatureTable, ...]) -> tuple[FeatureTable, ...]:
        if problem := feature_contradiction(features):
            raise ValueError(problem)
        return features

    @field_validator("setup")
    @classmethod
    def _differ(cls, setups: tuple[Setup, ...], info: ValidationInfo) -> tuple[Setup, ...]:
        shared = [fixture.name for fixture in info.data.get("fixtures", ())]
        for number, setup in enumerate(setups):
            names = [*shared, *(fixture.name for fixture in setup.fixtures)]
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"'{setup.name}' has the fixture '{twice[0]}' more than once; each needs its own name")
            for other in setups[:number]:
                if other.name == setup.name:
                    raise ValueError(f"has the name '{setup.name}' more than once; each set-up needs its own")
                if other.model_copy(update={"name": setup.name}) == setup:
                    raise ValueError(f"'{other.name}' and '{setup.name}' are equal; omit one of them")
        return setups

    @field_validator("picture")
    @classmethod
    def _hides_known_objects(cls, picture: Picture, info: ValidationInfo) -> Picture:
        known = [*_CELL_OBJECTS, *(fixture.name for fixture in info.data.get("fixtures", ()))]
        for name in picture.hide:
            if name not in known:
                raise ValueError(f".hide names '{name}', which this cell does not have; it has: {', '.join(known)}")
        return picture
