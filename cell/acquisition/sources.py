"""Where points come from: plug-ins of the entry-point group `cell.acquisition`, imported only when chosen.

A plug-in is a class that is called with what stands behind its name in `--acquire NAME:ARGUMENT` and a `Context`, and
implements `Acquisition`. Another distribution adds one with

    [project.entry-points."cell.acquisition"]
    acme = "acme_scanner.points:Acme"       # then --acquire acme:192.168.0.7

docs/internals/plug_ins.md shows how to write one.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from cell.errors import UsageError
from planner.values import Floats, Ints, Value, freeze

if TYPE_CHECKING:
    from pydantic import JsonValue

    from cell.runs.cell import RunCell

GROUP = "cell.acquisition"

Frame = Literal["scanner", "flange", "base", "object"]
FRAMES: tuple[Frame, ...] = get_args(Frame)


@dataclass(frozen=True, slots=True, eq=False)
class View(Value):
    """Where the arm stands, by the controller's report; of a sweep all its poses.

    Attributes:
        stop: number of the view, from 1 in visiting order.
        candidate: its row of viewpoints.npz.
        q: (K, axes) joint angles [rad], KUKA signs, in driving order as all poses.
        T_base_flange: (K, 4, 4) [m].
        T_object_scanner: (K, 4, 4) [m].
        T_base_object: (4, 4) the placement [m].
        order: (K,) numbers of the poses in the order of the plan.
    """

    stop: int
    candidate: int
    q: Annotated[Floats, "K axes"]
    T_base_flange: Annotated[Floats, "K 4 4"]
    T_object_scanner: Annotated[Floats, "K 4 4"]
    T_base_object: Annotated[Floats, "4 4"]
    order: Annotated[Ints, "K"]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def middle(self) -> int:
        """Which of the poses of a sweep stands for it; 0 of a view at rest."""
        return int(self.order[len(self.order) // 2])

    def T_object(self, frame: Frame) -> Floats:
        """(4, 4) from a frame to the object's [m]; of a sweep in its middle pose."""
        to_object = np.asarray(np.linalg.inv(self.T_base_object), dtype=np.float64)
        frames: dict[Frame, Floats] = {
            "scanner": self.T_object_scanner[self.middle],
            "flange": to_object @ self.T_base_flange[self.middle],
            "base": to_object,
            "object": np.eye(4),
        }
        return frames[frame]


@dataclass(frozen=True, slots=True, eq=False)
class Acquired:
    """The points of one view.

    Attributes:
        points: (P, 3) [m].
        frame: that they are in.
        kept: further arrays for the scan's file, by name: what a simulation alone knows.
        told: what the event says, JSON types.
    """

    points: Floats
    frame: Frame
    kept: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    told: "Mapping[str, JsonValue]" = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What a plug-in may use.

    Attributes:
        cell: part, surroundings and scanner.
        options: of `cell scan`, as its manifest keeps them.
        seed: of the execution.
        folder: of the execution; what is received may be kept in its `raw`.
        say: told in a sentence what is waited for or went wrong.
    """

    cell: "RunCell"
    options: Mapping[str, Any]
    seed: int
    folder: Path
    say: Callable[[str], None]


class Acquisition(Protocol):
    """Gives the points of a view while the arm stands there.

    Attributes:
        source: where they come from, as reports name it: "simulated", or "files of /data/scans".
    """

    source: str

    def take(self, view: View) -> Acquired | None:
        """The points; None where there are none to be had: the view is then missing, and resumable."""
        ...


class AcquisitionClass(Protocol):
    """What an entry point of the group names."""

    def __call__(self, argument: str, context: Context) -> Acquisition:
        """Make it; raise `cell.errors.UsageError` where the argument cannot be."""
        ...


def names() -> tuple[str, ...]:
    """Names of all that is installed, sorted; nothing is imported."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def load(text: str) -> tuple[AcquisitionClass, str]:
    """The class that `--acquire` names, and its argument.

    Args:
        text: "simulated", "files:DIR", "command:CMD" or "NAME:ARGUMENT".

    Raises:
        UsageError: if no installed distribution offers the name, two do, or the one that does cannot be imported.
    """
    name, _, argument = text.partition(":")
    found: list[EntryPoint] = [point for point in entry_points(group=GROUP) if point.name == name]
    if not found:
        again = "" if names() else " (scan-cell was installed before it had any: install it again)"
        raise UsageError(
            f"--acquire {text} names no source of points; installed are: {', '.join(names()) or 'none'}{again}"
        )
    if len({point.value for point in found}) > 1:
        raise UsageError(
            f"--acquire {name} is offered by {' and '.join(p.value for p in found)}; uninstall all but one"
        )
    try:
        kind: AcquisitionClass = found[0].load()
    except Exception as error:  # a foreign plug-in may fail in any way at import
        raise UsageError(
            f"--acquire {name} cannot be imported from {found[0].value}: {type(error).__name__}: {error}; repair or "
            "uninstall that distribution"
        ) from error
    return kind, argument
