"""What stands in the cell beside robot and part: the `[[fixtures]]` of a scene, of a set-up (`[[setup]]`) only then."""

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from cell.part.formats import units_of
from cell.scene.fields import Positive, Table, Triple, Units, existing_file
from cell.scene.posed import Posed

RESERVED_NAMES = (
    *("base", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6"),
    *("bracket", "housing", "part", "object", "post", "pedestal", "floor", "world"),
)


class NamedFixture(Posed):
    """What every fixture has."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ .-]*$", max_length=100)]  # it names a file
    attached_to: Literal["base", "object"] = "base"
    occludes: bool = True

    @field_validator("name")
    @classmethod
    def _not_reserved(cls, name: str) -> str:
        if name in RESERVED_NAMES:
            raise ValueError(f"is '{name}', which the cell uses itself; choose another name")
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
    """A mesh file: its true triangles occlude, and collide unless `plan.collision` is "hull"."""

    shape: Literal["mesh"]
    path: str
    units: Units

    @model_validator(mode="before")
    @classmethod
    def _of_its_format(cls, table: Any) -> Any:
        own = units_of(str(table.get("path"))) if isinstance(table, dict) else None
        return {"units": own, **table} if own is not None else table

    @field_validator("path")
    @classmethod
    def _found(cls, path: str, info: ValidationInfo) -> str:
        return existing_file(path, info)


Fixture = Annotated[BoxFixture | CylinderFixture | MeshFixture, Field(discriminator="shape")]


class Post(Table):
    """The round post on which the part stands, from the floor to the height of the part's lowest point."""

    enabled: bool = True
    diameter_mm: Positive = 40.0


class Setup(Posed):
    """A pose of the part that `cell setups` may use: where its centre stands, and what stands about it only then."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ .-]*$", max_length=100)]
    position_mm: Triple
    fixtures: Annotated[tuple[Fixture, ...], Field(strict=False)] = ()
    post: Post | None = None
