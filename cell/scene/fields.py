"""The pieces of which the scene's tables are made: a strict, frozen table, and numbers with their limits.

From pydantic's errors to sentences for the author of a scene file: the key, what is wrong, what would be valid.
"""

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo
from pydantic_core import ErrorDetails

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
AxisLimits = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
MaybeEndless = Annotated[float, Field(gt=0, allow_inf_nan=True)]
JerkLimits = tuple[MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless]
Share = Annotated[float, Field(gt=0, le=1)]
Fov = Annotated[float, Field(gt=0, lt=180)]
Grazing = Annotated[float, Field(ge=0, le=90)]
# TOML has lists only: lenient about the container, strict about what is in it.
Four = Annotated[tuple[float, float, float, float], Field(strict=False)]
Triple = Annotated[tuple[float, float, float], Field(strict=False)]
Units = Literal["mm", "cm", "m", "um", "in"]


class Table(BaseModel):
    """A table of the scene file: every key known, strictly typed, finite; frozen."""

    # Built when first used: `--help` needs only the fields.
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


def existing_file(path: str, info: ValidationInfo, kind: str = "a mesh file") -> str:
    """The absolute path of a file that a scene names."""
    folder = Path((info.context or {}).get("folder", Path.cwd()))
    try:
        full = folder / Path(path).expanduser()
        found = full.is_file()
    except (OSError, ValueError, RuntimeError):  # longer than any name, a zero in it, the home of nobody
        raise ValueError(f"is no name that a file can have; give {kind}, relative to the scene file") from None
    if not found:
        raise ValueError(f"is '{path}', and there is no file {full}; give {kind}, relative to the scene file")
    return str(full)


_COMPARISONS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
_WANTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text in quotes",
    "tuple_type": "a list",
    "finite_number": "a finite number",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dict_type": "a table",
    "string_pattern_mismatch": "a name of letters, digits, spaces, '_', '-' and '.'",
}
_KEY = re.compile(r"\b\w+(?:\.\w+)+|^\w+")  # in a sentence: the first word is one, others have a dot


def sentences(error: ValidationError, model: type[BaseModel], names: Mapping[str, str] | None = None) -> list[str]:
    """One sentence a problem, in the order of the file's keys as the model lists them.

    Args:
        error: of pydantic.
        model: the table as a whole.
        names: how the user wrote keys that came from elsewhere than the file, by key.
    """
    details = error.errors()
    lengths: dict[tuple[int | str, ...], int] = {}  # of lists that are too short: pydantic names every missing place
    for detail in details:
        if detail["type"] == "missing" and isinstance(detail["loc"][-1], int):
            lengths[detail["loc"][:-1]] = max(lengths.get(detail["loc"][:-1], 0), detail["loc"][-1] + 1)
    found = []
    for detail in details:
        sentence = _sentence(detail, model, lengths)
        if names:
            sentence = _KEY.sub(lambda key: names.get(key[0], key[0]), sentence)
        if sentence not in found:
            found.append(sentence)
    return found


def did_you_mean(word: object, known: Sequence[str]) -> str:
    """A hint (with a space at its end) where a known word is close, else nothing."""
    close = difflib.get_close_matches(str(word).lower(), known, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'? " if close else ""


def _sentence(detail: ErrorDetails, model: type[BaseModel], lengths: Mapping[tuple[int | str, ...], int]) -> str:
    kind, loc, value, context = detail["type"], detail["loc"], detail.get("input"), detail.get("ctx", {})
    keys, owner = _resolve(loc, model)
    where = _path(keys)
    if kind == "extra_forbidden":
        known = list(owner.model_fields) if owner else []
        return f"{where} is an unknown key; {did_you_mean(keys[-1], known)}valid are: {', '.join(known)}"
    if kind == "missing" and isinstance(keys[-1], int):
        return f"{_path(keys[:-1])} has {len(value or ())} values; it must have {lengths[loc[:-1]]}"
    if kind == "missing":
        return f"{where} is missing"
    if kind == "string_too_long":
        return f"{where} has {len(str(value))} characters; it must have at most {context['max_length']}"
    if kind == "too_long":
        return f"{where} has {context['actual_length']} values; it must have {context['max_length']}"
    if kind == "too_short":
        return f"{where} has {context['actual_length']} values; it must have at least {context['min_length']}"
    if kind == "literal_error":
        known = [word.strip("'") for word in context["expected"].replace(" or ", ", ").split(", ")]
        return f"{where} is {_show(value)}; {did_you_mean(value, known)}valid are: {', '.join(known)}"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        known = [tag for field in model.model_fields.values() for tag in _tagged(field.annotation)]
        if kind == "union_tag_not_found":
            return f"{where}.shape is missing; valid are: {', '.join(known)}"
        return (
            f"{where}.shape is '{context['tag']}'; {did_you_mean(context['tag'], known)}valid are: {', '.join(known)}"
        )
    if kind in _COMPARISONS:
        key, word = _COMPARISONS[kind]
        return f"{where} is {_show(value)}; it must be {word} {context[key]:g}"
    if kind == "value_error":
        told = str(context["error"])  # a table as a whole names the key itself: ".key is ..."
        return (where + told).removeprefix(".") if told.startswith(".") else f"{where} {told}"
    if kind in _WANTED:
        return f"{where} is {_show(value)}; it must be {_WANTED[kind]}"
    return f"{where} is {_show(value)}, which it cannot be"


def _resolve(loc: tuple[int | str, ...], model: type[BaseModel]) -> tuple[list[int | str], type[BaseModel] | None]:
    """The keys as they stand in the file (pydantic adds the tag of a union), and the table that owns the last one."""
    keys: list[int | str] = []
    owner: type[BaseModel] | None = model
    annotation: Any = model
    for step in loc:
        tagged = _tagged(annotation)
        if keys and isinstance(keys[-1], int) and step in tagged:
            annotation = owner = tagged[str(step)]
            continue
        keys.append(step)
        if isinstance(step, str):
            table = next((a for a in _models(annotation) if step in a.model_fields), None)
            annotation = table.model_fields[step].annotation if table else None
            nested = _models(annotation) if table else []
            if step != loc[-1] and len(nested) == 1:
                owner = nested[0]
    return keys, owner


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Every model class inside an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for inner in get_args(annotation) for found in _models(inner)]


def _tagged(annotation: Any) -> dict[str, type[BaseModel]]:
    """The classes of a union told apart by their `shape`."""
    classes = [found for found in _models(annotation) if "shape" in found.model_fields]
    return {str(get_args(found.model_fields["shape"].annotation)[0]): found for found in classes}


def _path(keys: Sequence[int | str]) -> str:
    text = ""
    for key in keys:
        text += f"[{key}]" if isinstance(key, int) else f".{key}"
    return text.removeprefix(".")


def _show(value: object) -> str:
    """A value as it would stand in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."
