import ast
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from numpy.typing import NDArray

from planner import values
from planner.errors import PlannerError
from planner.values import Floats, Ints, Value, freeze, readonly

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True, eq=False)
class Motion(Value):
    via: Annotated[Floats, "n 6"]
    pose: Annotated[Ints, "n"]
    start: Annotated[NDArray[np.int32], "n+1"]
    names: Annotated[tuple[str, ...], "n"]
    square: Annotated[Floats, "m m"]
    anything: Annotated[NDArray[np.bool_], "_ 2"]
    sigma: Annotated[NDArray[np.float32], "n"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Items(values.Rows):
    place: Annotated[Floats, "n 3"]
    region: Annotated[Ints, "n"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Rows(Value):
    rows: Annotated[Ints, "n"]

    def __post_init__(self) -> None:
        freeze(self, n=3)


def motion(**changes: object) -> Motion:
    """Return a valid value with changes."""
    fields = {
        "via": np.zeros((2, 6)),
        "pose": [0, -1],
        "start": [0, 1, 2],
        "names": ("a", "b"),
        "square": np.eye(3),
        "anything": np.ones((5, 2)),
    }
    return Motion(**{**fields, **changes})  # type: ignore[arg-type]  # the broken cases are the point


INVALID = {
    "too few columns": ({"via": np.zeros((2, 5))}, "via has shape (2, 5); it must be (2, 6)"),
    "an axis too few": ({"via": np.zeros(6)}, "via has shape (6,); it must be (n, 6)"),
    "no array": ({"via": 1.0}, "via has shape (); it must be (n, 6)"),
    "lengths of one name disagree": ({"pose": [0, 1, 2]}, "pose has shape (3,); it must be (2,)"),
    "not one more": ({"start": [0, 1]}, "start has shape (2,); it must be (3,)"),
    "an empty array that must have one more": ({"via": np.zeros((0, 6)), "pose": [], "start": []}, "it must be (1,)"),
    "a tuple of another length": ({"names": ("a",)}, "names has shape (1,); it must be (2,)"),
    "not square": ({"square": np.zeros((2, 3))}, "square has shape (2, 3); it must be (2, 2)"),
    "any length, but not of the other axis": ({"anything": [[True]]}, "anything has shape (1, 1); it must be (any, 2)"),
    "NaN": ({"via": np.full((2, 6), np.nan)}, "via contains NaN; every value must be a number"),
    "NaN in an optional array": ({"sigma": [1.0, np.nan]}, "sigma contains NaN; every value must be a number"),
    "None for a required array": ({"via": None}, "via has shape (); it must be (n, 6)"),
    "a wrong length of an optional array": ({"sigma": [1.0]}, "sigma has shape (1,); it must be (2,)"),
}


@pytest.mark.parametrize(("changes", "sentence"), INVALID.values(), ids=list(INVALID))
def test_wrong_shapes_and_nan_are_refused(changes: dict[str, object], sentence: str) -> None:
    """The error names the array, its shape and the required one."""
    with pytest.raises(PlannerError, match=re.escape(sentence)):
        motion(**changes)


def test_arrays_are_cast_read_only_copies() -> None:
    """Later changes of the arguments do not affect the value, and its own arrays are read-only."""
    original = np.asfortranarray(np.arange(12.0).reshape(2, 6))
    value = motion(via=original, sigma=[1, np.inf])
    original[:] = -1.0
    np.testing.assert_array_equal(value.via, np.arange(12.0).reshape(2, 6))
    assert value.via.flags.c_contiguous
    kinds = [array.dtype for array in (value.via, value.pose, value.start, value.anything, value.sigma)]
    assert kinds == [np.float64, np.int64, np.int32, np.bool_, np.float32]
    for array in (value.via, value.pose, value.start, value.square, value.anything, value.sigma):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    assert value.names == ("a", "b")
    assert not np.shares_memory(replace(value, pose=[1, 1]).via, value.via)


def test_empty_arrays_and_none_are_valid() -> None:
    """Length 0 is valid, and a field that may be None may be left out."""
    empty = motion(
        via=np.zeros((0, 6)), pose=[], start=[0], names=(), square=np.zeros((0, 0)), anything=np.ones((0, 2))
    )
    assert empty.sigma is None
    assert empty.pose.dtype == np.int64


def test_known_lengths_are_checked() -> None:
    """A length given by name applies to all arrays that have it."""
    assert len(Rows(np.arange(3)).rows) == 3
    with pytest.raises(PlannerError, match=re.escape("rows has shape (4,); it must be (3,)")):
        Rows(np.arange(4))


def test_a_single_array_has_the_same_messages() -> None:
    """`readonly` copies and refuses like a value, with the same messages."""
    original = np.zeros((2, 3))
    copy = readonly("ends", original, (None, 3))
    assert not np.shares_memory(copy, original)
    assert not copy.flags.writeable
    with pytest.raises(PlannerError, match=re.escape("ends has shape (2, 3); it must be (any, 4)")):
        readonly("ends", original, (None, 4))
    with pytest.raises(PlannerError, match="ends contains NaN"):
        readonly("ends", [np.nan], (1,))


def test_items_are_picked_and_joined_by_their_rows() -> None:
    """Every array has the rows of the items; an array that no part has stays None, one that some lack is refused."""
    places = np.arange(12.0).reshape(4, 3)
    items = Items(places, np.array([0, 1, 2, 3]))
    picked = items.pick(np.array([2, 0]))
    assert len(items) == 4
    np.testing.assert_array_equal(picked.place, places[[2, 0]])
    np.testing.assert_array_equal(picked.region, [2, 0])
    np.testing.assert_array_equal(items.pick(items.place[:, 0] > 5).region, [2, 3])
    np.testing.assert_array_equal(Items.join([picked, items]).region, [2, 0, 0, 1, 2, 3])
    assert Items.join([Items(places), Items(places)]).region is None
    with pytest.raises(PlannerError):
        Items.join([Items(places), items])


def test_classes_with_shapes_derive_from_value_and_freeze() -> None:
    """In cell and planner each class with shapes derives from `Value`, and each `__post_init__` calls `freeze`."""
    found = 0
    for path in [*(ROOT / "planner").rglob("*.py"), *(ROOT / "cell").rglob("*.py")]:
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "Annotated[" in text else ():
            if isinstance(node, ast.ClassDef) and "dataclass" in "".join(map(ast.unparse, node.decorator_list)):
                types = [ast.unparse(field.annotation) for field in node.body if isinstance(field, ast.AnnAssign)]
                own = [ast.unparse(part) for part in node.body if getattr(part, "name", "") == "__post_init__"]
                if any("Annotated[" in kind for kind in types):
                    found += 1
                    bases = {ast.unparse(base) for base in node.bases}
                    assert bases & {"Value", "Rows"}, f"{path}: {node.name} must derive from Value"
                    assert all("freeze(self" in body for body in own), f"{path}: {node.name} must call freeze"
    assert found > 40
