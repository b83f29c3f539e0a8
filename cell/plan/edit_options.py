"""Options of `cell edit`, checked as far as no plan is needed."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, NamedTuple, Self

from pydantic import Field, model_validator

from cell.scene.fields import NotNegative, Table
from cell.scene.options import Option

_VIEWS, _MOTION = "Views", "Order"
_DROPPED_RANGE = Option(
    "Neighbourhood of a dropped view in which no view is added: other candidates within this distance of its position "
    "and this angle of its viewing axis are banned, in later repairs as well; 0mm,0deg bans the dropped pose only.",
    _VIEWS,
    metavar="LENGTHmm,ANGLEdeg",
    form="a length and an angle with their units",
    examples=("50mm,20deg",),
)
_POSE_FORM = "x,y,z,a,b,c of the scanner in base (mm and deg, KUKA ABC)"

Number = Annotated[int, Field(ge=1)]
Numbers = Annotated[tuple[Number, ...], Field(strict=False)]
Millimetres = Annotated[float, Field(ge=-1e5, le=1e5)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Candidates = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(strict=False)]


class Pose(NamedTuple):
    """The scanner in the robot's base frame [mm, deg], KUKA's A, B, C."""

    x: Millimetres
    y: Millimetres
    z: Millimetres
    a: Degrees
    b: Degrees
    c: Degrees


class Move(NamedTuple):
    """A view with its new pose."""

    view: Number
    pose: Pose


class Turn(NamedTuple):
    """A view with an angle about its viewing axis [deg]."""

    view: Number
    angle: Degrees


def _grouped(size: int, convert: Callable[[Sequence[float]], Any]) -> Callable[[Sequence[Any]], Sequence[Any]]:
    """Read values of an option, `size` numbers each: texts, sequences of numbers, or a table of view and value."""

    def read(values: Sequence[Any]) -> Sequence[Any]:
        flat: list[float] = []
        for value in _flat(values):
            flat += map(float, value.replace(":", ",").split(",") if isinstance(value, str) else [value])
        if len(flat) % size:
            raise ValueError
        return [convert(flat[k : k + size]) for k in range(0, len(flat), size)]

    return read


def _flat(value: Any) -> list[Any]:
    """Return the numbers and texts of nested sequences and tables."""
    if isinstance(value, str | int | float):
        return [value]
    if isinstance(value, Mapping):
        return [each for pair in value.items() for each in _flat(pair)]
    return [each for piece in value for each in _flat(piece.tolist() if hasattr(piece, "tolist") else piece)]


def _whole(number: float) -> int:
    if number != int(number):
        raise ValueError
    return int(number)


def _pose(numbers: Sequence[float]) -> Pose:
    return Pose(*numbers)


def _move(numbers: Sequence[float]) -> Move:
    return Move(_whole(numbers[0]), _pose(numbers[1:]))


def _turn(numbers: Sequence[float]) -> Turn:
    return Turn(_whole(numbers[0]), numbers[1])


class Edit(Table):
    """Changes of a plan; views are named by their numbers in visiting order, from 1."""

    drop: Annotated[
        Numbers, Option("Views to drop.", _VIEWS, metavar="N[,N...]", form="numbers of views", examples=("4", "4,7"))
    ] = ()
    dropped_range_mm: Annotated[NotNegative, _DROPPED_RANGE] = 50.0
    dropped_range_deg: Annotated[NotNegative, Field(le=180), _DROPPED_RANGE] = 20.0
    move: Annotated[
        tuple[Move, ...],
        Field(strict=False),
        Option(
            "Move a view to another pose: the scanner in base, mm and KUKA ABC. May be given several times.", _VIEWS,
            metavar="N:X,Y,Z,A,B,C", form=f"number:{_POSE_FORM}", examples=("7:812,430,655,90,0,180",),
            convert=_grouped(7, _move),
        ),
    ] = ()  # fmt: skip
    turn: Annotated[
        tuple[Turn, ...],
        Field(strict=False),
        Option(
            "Turn a view about its viewing axis. May be given several times.", _VIEWS, metavar="N:DEG",
            form="number:angle", examples=("7:90",), convert=_grouped(2, _turn),
        ),
    ] = ()  # fmt: skip
    add_candidate: Annotated[
        Candidates,
        Option("Candidates that become views.", _VIEWS, metavar="ID[,ID...]", form="candidates by their numbers",
               examples=("533",)),
    ] = ()  # fmt: skip
    add_pose: Annotated[
        tuple[Pose, ...],
        Field(strict=False),
        Option(
            "Add a view: the scanner in base, mm and KUKA ABC. May be given several times.", _VIEWS,
            metavar="X,Y,Z,A,B,C", form=_POSE_FORM, examples=("812,430,655,90,0,180",), convert=_grouped(6, _pose),
        ),
    ] = ()  # fmt: skip
    table_angle_deg: Annotated[
        Degrees, Option("Angle of the rotary table for the poses of --move and --add-pose.", _VIEWS)
    ] = 0.0
    repair: Annotated[bool, Option("Add the fewest views that restore the requested coverage.", _VIEWS)] = False
    order: Annotated[
        Numbers,
        Option(
            "Visiting order: all kept views, and added ones by the numbers after the last view (candidates first). "
            "Default: a new order if views change.",
            _MOTION, metavar="N,N,...", form="numbers of views", examples=("3,1,2",),
        ),
    ] = ()  # fmt: skip
    keep_order: Annotated[bool, Option("Keep the order; added views are inserted where they cost least.", _MOTION)] = (
        False
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        changes = Counter([*self.drop, *(move.view for move in self.move), *(turn.view for turn in self.turn)])
        if twice := [view for view, count in changes.items() if count > 1]:
            raise ValueError(f".drop, move and turn name view {twice[0]} twice; change a view in one way")
        if twice := [view for view, count in Counter(self.order).items() if count > 1]:
            raise ValueError(f".order names view {twice[0]} twice; name each view once")
        if self.table_angle_deg and not (self.move or self.add_pose):
            raise ValueError(".table_angle_deg concerns the poses of move and add_pose, and none is given; omit it")
        if self.order and self.keep_order:
            raise ValueError(".order and keep_order both define the visiting order; give one of them")
        return self
