"""Read-only arrays, and the base class of frozen values that hold them.

The types of the fields of a frozen dataclass declare its arrays, and `freeze` copies and checks them:

    @dataclass(frozen=True, slots=True, eq=False)
    class Traversal(Value):
        via: Annotated[Floats, "n 6"]
        pose: Annotated[Ints, "n"]
        duration: float

The words beside an array's type are the lengths of its axes: a number, `_` for any length, or a name for one length
throughout the value (`n+1` is one more). Beside another type they are its `len()`. A field that may be None
(`Annotated[Floats, "n 6"] | None`) may also be left out.
"""

import sys
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, NamedTuple, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from planner.errors import PlannerError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Ints32 = NDArray[np.int32]
Bools = NDArray[np.bool_]


def readonly(name: str, values: ArrayLike, shape: Sequence[int | None], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Copy, cast and shape-check an array and make it read-only.

    Args:
        name: name of the array in error messages.
        values: anything that NumPy can convert to an array.
        shape: the required shape; None for any length of an axis.
        dtype: element type of the copy.

    Returns:
        A C-contiguous, read-only copy without NaN.
    """
    array = np.array(values, dtype=dtype, order="C", copy=True)
    _fit(name, array.shape, [("_", 0) if length is None else ("", length) for length in shape], {})
    return _sealed(name, array)


class Value:
    """Base class of frozen dataclasses with arrays."""

    __slots__ = ()

    def __post_init__(self) -> None:
        """Copy and check the arrays; subclasses with more checks call `freeze` first."""
        freeze(self)


def freeze(value: Value, /, **lengths: int) -> None:
    """Copy, cast and shape-check the arrays of a frozen dataclass during its construction; make them read-only.

    Args:
        value: the value; the types of its fields declare its arrays, as this module's docstring describes.
        **lengths: known lengths by their names.
    """
    fields = _declared(type(value))  # type: ignore[arg-type]  # mypy takes the hash of a class for its instances'
    for name, dtype, axes, optional in fields:
        given = getattr(value, name)
        if given is None and optional:
            continue
        if dtype is None:
            _fit(name, (len(given),), axes, lengths)
            continue
        array = np.array(given, dtype=dtype, order="C", copy=True)
        _fit(name, array.shape, axes, lengths)
        object.__setattr__(value, name, _sealed(name, array))


_Axes = Sequence[tuple[str, int]]  # a name and a number to add; "" before a fixed length, "_" for any


class _Declared(NamedTuple):
    """A field with a shape; without element type if only its length is declared."""

    name: str
    dtype: np.dtype[Any] | None
    axes: _Axes
    optional: bool


@cache
def _declared(kind: type) -> tuple[_Declared, ...]:
    """Return the fields of a dataclass with a shape, in their order."""
    found = []
    for name, declared in kind.__annotations__.items():
        if isinstance(declared, str):  # of a module with postponed annotations
            if "Annotated" not in declared:
                continue
            declared = eval(declared, vars(sys.modules[kind.__module__]))
        for part in (declared, *get_args(declared)):
            if get_origin(part) is Annotated:
                array, shape = get_args(part)
                dtype = np.dtype(get_args(get_args(array)[1])[0]) if get_origin(array) is np.ndarray else None
                found.append(_Declared(name, dtype, _axes(shape), part is not declared))
    return tuple(found)


def _axes(shape: str) -> _Axes:
    parts = [word.partition("+") for word in shape.split()]
    return [("", int(length)) if length.isdigit() else (length, int(more or 0)) for length, _, more in parts]


def _fit(name: str, shape: tuple[int, ...], axes: _Axes, lengths: dict[str, int]) -> None:
    """Compare a shape with its axes; new names take their lengths from it."""
    if len(shape) == len(axes):
        for have, (axis, length) in zip(shape, axes, strict=True):
            if axis == "_":
                continue
            if axis:
                length += lengths.setdefault(axis, max(have - length, 0))
            if have != length:
                break
        else:
            return
    wanted = ["any" if a == "_" else str(lengths.get(a, 0) + n) if a == "" or a in lengths else a for a, n in axes]
    raise PlannerError(f"{name} has shape {shape}; it must be ({', '.join(wanted)}{',' * (len(wanted) == 1)})")


def _sealed(name: str, array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype.kind == "f" and np.isnan(array).any():
        raise PlannerError(f"{name} contains NaN; every value must be a number")
    array.flags.writeable = False
    return array
