"""Immutable values of read-only arrays, and enumerations with descriptions.

The fields of a frozen dataclass declare the shapes of its arrays, and `freeze` checks them and makes them read-only:

    @dataclass(frozen=True, slots=True, eq=False)
    class Segment(Value):
        via: Annotated[Floats, "n 6"]
        pose: Annotated[Ints, "n"]
        duration: float

The words beside an array type are the lengths of its axes: a number, `_` for any length, or a name, which stands for
one length in the whole value (`n+1` is one more). Beside another type they are its `len()`. A field that may be None
(`Annotated[Floats, "n 6"] | None`) may be omitted.
"""

import sys
from collections.abc import Sequence
from enum import IntEnum
from functools import cache
from typing import Annotated, Any, NamedTuple, Self, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from planner.errors import PlannerError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Ints32 = NDArray[np.int32]
Bools = NDArray[np.bool_]


class DescribedEnum(IntEnum):
    """Enumeration whose members are declared as `NAME = number, sentence`; files contain only the number.

    Attributes:
        sentence: description of the member for reports.
    """

    sentence: str

    def __new__(cls, value: int, sentence: str = "") -> Self:
        """Create a member; `Kind(number)` returns an existing one."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member


class Value:
    """Base class of the frozen dataclasses of arrays."""

    __slots__ = ()

    def __post_init__(self) -> None:
        """Check and freeze the arrays; subclasses that check more call `freeze` first."""
        freeze(self)


def freeze(value: Value, /, **lengths: int) -> None:
    """Copy, cast and check the arrays of a frozen dataclass and make them read-only, during its construction.

    Args:
        value: the value; the types of its fields declare the shapes, see this module's docstring.
        **lengths: known lengths of named axes.

    Raises:
        PlannerError: if a shape differs, lengths of one name disagree, or a floating-point value is NaN.
    """
    fields = _declared(type(value))  # type: ignore[arg-type]  # mypy takes the hash of a class for its instances'
    for name, dtype, axes, optional in fields:
        content = getattr(value, name)
        if content is None and optional:
            continue
        if dtype is None:
            _check_shape(name, (len(content),), axes, lengths)
            continue
        array = np.array(content, dtype=dtype, order="C", copy=True)
        _check_shape(name, array.shape, axes, lengths)
        object.__setattr__(value, name, _sealed(name, array))


class Rows(Value):
    """Base class of values whose arrays all have one row for each item; an array may be None."""

    __slots__ = ()

    def __len__(self) -> int:
        return len(self._arrays()[0])

    def pick(self, which: NDArray[Any]) -> Self:
        """Return some of the items, given as (n,) bool or as indices."""
        kind: Any = type(self)
        picked: Self = kind(*(None if array is None else array[which] for array in self._arrays()))
        return picked

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Concatenate the items."""
        kind: Any = cls
        known = [[each for each in column if each is not None] for column in zip(*map(cls._arrays, parts), strict=True)]
        joined: Self = kind(*(np.concatenate(arrays) if arrays else None for arrays in known))
        return joined

    def _arrays(self) -> list[Any]:
        return [getattr(self, each.name) for each in _declared(type(self))]  # type: ignore[arg-type]  # as in `freeze`


def readonly(name: str, values: ArrayLike, shape: Sequence[int | None], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Return a C-contiguous, read-only copy of an array, cast and checked.

    Args:
        name: name of the array in error messages.
        values: the array.
        shape: required shape; None stands for any length of that axis.
        dtype: element type of the copy.

    Raises:
        PlannerError: if the shape differs or a floating-point value is NaN.
    """
    array = np.array(values, dtype=dtype, order="C", copy=True)
    _check_shape(name, array.shape, [("_", 0) if length is None else ("", length) for length in shape], {})
    return _sealed(name, array)


_Axes = Sequence[tuple[str, int]]  # a name and a number to add; "" for a fixed length, "_" for any


class _Declared(NamedTuple):
    """A field with a shape; without element type if only its length is declared."""

    name: str
    dtype: np.dtype[Any] | None
    axes: _Axes
    optional: bool


@cache
def _declared(kind: type) -> tuple[_Declared, ...]:
    """Return the fields of a dataclass that have a shape."""
    fields = []
    for name, declared in kind.__annotations__.items():
        if isinstance(declared, str):  # in a module with postponed annotations
            if "Annotated" not in declared:
                continue
            declared = eval(declared, vars(sys.modules[kind.__module__]))
        for part in (declared, *get_args(declared)):
            if get_origin(part) is Annotated:
                array, shape = get_args(part)
                fields.append(_Declared(name, _element_type(array), _axes(shape), part is not declared))
    return tuple(fields)


def _element_type(array: Any) -> np.dtype[Any] | None:
    """Return the element type of NDArray[T]; None for another type.

    NDArray[T] is np.ndarray[shape, np.dtype[T]], and from Python 3.12 and NumPy 2.5 on an alias with T alone.
    """
    if get_origin(array) is not get_origin(Floats):
        return None
    last = get_args(array)[-1]
    element: np.dtype[Any] = np.dtype(*get_args(last) or (last,))
    return element


def _axes(shape: str) -> _Axes:
    words = [word.partition("+") for word in shape.split()]
    return [("", int(length)) if length.isdigit() else (length, int(more or 0)) for length, _, more in words]


def _check_shape(name: str, shape: tuple[int, ...], axes: _Axes, lengths: dict[str, int]) -> None:
    """Compare a shape with its declaration; the first length of a named axis defines it."""
    if len(shape) == len(axes):
        for actual, (axis, length) in zip(shape, axes, strict=True):
            if axis == "_":
                continue
            if axis:
                length += lengths.setdefault(axis, max(actual - length, 0))
            if actual != length:
                break
        else:
            return
    required = ["any" if a == "_" else str(lengths.get(a, 0) + n) if a == "" or a in lengths else a for a, n in axes]
    raise PlannerError(f"{name} has shape {shape}; it must be ({', '.join(required)}{',' * (len(required) == 1)})")


def _sealed(name: str, array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype.kind == "f" and np.isnan(array).any():
        raise PlannerError(f"{name} contains NaN; every value must be a number")
    array.flags.writeable = False
    return array
