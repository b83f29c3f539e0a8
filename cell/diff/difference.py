"""The values that `cell diff` finds and prints: settings, views, surface and numbers of two runs, A and B."""

from pydantic import Field, JsonValue

from cell.runs.schema import JsonTable, optional


def shown(value: object) -> str:
    """A value as people read it; a matrix is told as such."""
    match value:
        case None:
            return "-"
        case float():
            return f"{value:.6g}"
        case [[*_], *_]:
            return "(another transform)"
        case list():
            return ", ".join(shown(each) for each in value)
        case _:
            return str(value)


class Setting(JsonTable):
    """A key that two runs have different values of; null where one has none."""

    key: str = Field(description="of scene.resolved.json, or of the settings of an execution's report.json")
    a: JsonValue
    b: JsonValue


class MovedView(JsonTable):
    """A view of B that measures most of what one of A measures, from another pose."""

    a: int = Field(description="number in A's visiting order, from 1")
    b: int = Field(description="number in B's visiting order, from 1")
    distance_mm: float = Field(description="between the two scanner positions, in the part's frame")
    angle_deg: float = Field(description="between the two orientations")
    shared: float = Field(description="area that both measure over area that either does, fraction")


class Views(JsonTable):
    """Views by their numbers in visiting order, from 1."""

    kept: tuple[tuple[int, int], ...] = Field(description="at the same pose to the part: (number in A, number in B)")
    moved: tuple[MovedView, ...] = Field(description="that do the same work from elsewhere")
    lost: tuple[int, ...] = Field(description="of A alone")
    new: tuple[int, ...] = Field(description="of B alone")


class Surface(JsonTable):
    """Area of one set of samples that A and B measure: of plans the visible one, of executions the sampled one."""

    samples: int = Field(description="that stand for the surface: A's held-out ones")
    area_mm2: float = Field(description="of the surface")
    a_mm2: float = Field(description="that A measures")
    b_mm2: float = Field(description="that B measures")
    gained_mm2: float = Field(description="that B measures and A does not")
    lost_mm2: float = Field(description="that A measures and B does not")


class Number(JsonTable):
    """A figure of both reports; null where one does not say it."""

    name: str = Field(description="with its unit")
    a: float | None
    b: float | None


class Difference(JsonTable):
    """What `cell diff --json` prints."""

    a: str = Field(description="folder")
    b: str = Field(description="folder")
    kind: str = Field(description="'plan' or 'execution', of both")
    settings: tuple[Setting, ...] = Field(description="that differ")
    views: Views
    surface: Surface | None = optional("left out where the two parts are not the same mesh")
    numbers: tuple[Number, ...] = Field(description="that differ")

    @property
    def empty(self) -> bool:
        """Whether nothing differs."""
        views, surface = self.views, self.surface
        other = bool(self.settings or self.numbers or views.moved or views.lost or views.new)
        renumbered = any(a != b for a, b in views.kept)
        same_surface = surface is not None and surface.gained_mm2 == surface.lost_mm2 == 0.0
        return same_surface and not other and not renumbered
