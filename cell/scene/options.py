"""Options of the command line and keywords of Python, derived from the fields of pydantic models.

An `Option` in the annotation makes a field an option. Type, unit, limits, choices and default are those of the field;
the option adds its purpose. Fields with the same option name form one option: its values fill them in order
(`--place x,y,z,A,B,C`), or the unit of each value selects the field (`--pose-sd 0.5mm,0.1deg`).
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from cell.errors import UsageError
from cell.scene.validation import did_you_mean, error_messages

Spell = Callable[[str], str]
"""Spells the name of an option: `flag` for the command line, `str` for a keyword of Python."""

Model = TypeVar("Model", bound=BaseModel)

_UNIT = re.compile(r"_(mm2|mm|deg|percent|share)$")
_METAVARS = {"mm": "MM", "deg": "DEG", "percent": "PERCENT"}
_MANY = 1e9  # limits above it are not shown
_SCALES = {"%": ("share", 0.01)}  # other units equal the ending of the key


@dataclass(frozen=True, slots=True)
class Option:
    """Makes a field an option of the command line and a keyword of Python.

    Attributes:
        help: purpose, a sentence; limits, choices and default are added.
        panel: heading in `--help`; "" for none.
        name: the keyword, if it is not the key without its unit.
        also: an alternative flag.
        metavar: placeholder of the value in `--help`, if unit and type do not give it.
        form: required form of a text, for the message that refuses one, if the type does not give it.
        examples: valid texts.
        counts: valid numbers of values; they fill several fields in order.
        separator: between values.
        convert: converts the values to the value of the field; raises ValueError for invalid ones.
    """

    help: str
    panel: str = ""
    name: str = ""
    also: str = ""
    metavar: str = ""
    form: str = ""
    examples: tuple[str, ...] = ()
    counts: tuple[int, ...] = ()
    separator: str = ","
    convert: Callable[[Sequence[Any]], Sequence[Any]] | None = None


@dataclass(frozen=True, slots=True)
class Kind:
    """Type of a field by its annotation.

    Attributes:
        base: bool, int, float or another type; str for choices.
        length: number of values of a tuple; 0 for a single value, -1 for any number.
        choices: the valid values.
        limits: in words, such as "above 0 to 1".
    """

    base: type
    length: int = 0
    choices: tuple[str, ...] = ()
    limits: str = ""


@dataclass(frozen=True, slots=True)
class OptionSpec:
    """An option and the fields that it fills, in order, by their keys ("plan.faces")."""

    name: str
    option: Option
    fields: Mapping[str, FieldInfo]

    @property
    def kinds(self) -> list[Kind]:
        """Type of each field."""
        return [_kind(field.annotation, field.metadata) for field in self.fields.values()]

    @property
    def kind(self) -> Kind:
        """Type of the first field: several fields of one option differ only in length."""
        return self.kinds[0]

    @property
    def by_unit(self) -> bool:
        """Whether the unit of a value selects the field that it fills."""
        return len(self.fields) > 1 and not self.option.counts

    @property
    def metavar(self) -> str | None:
        """Placeholder of the value in `--help`; None for a switch."""
        kind, unit = self.kind, _UNIT.search(next(iter(self.fields)))
        if kind.base is bool or self.option.metavar:
            return self.option.metavar or None
        one = _METAVARS.get(unit[1] if unit else "", {int: "N", float: "X"}.get(kind.base, "NAME"))
        return f"{one}[,{one}...]" if kind.length else one

    @property
    def help(self) -> str:
        """Purpose, limits or choices, and default."""
        kind, default = self.kind, self._default()
        has_choices = all(choice in self.option.help for choice in kind.choices)
        valid = kind.limits if has_choices else f"one of {', '.join(kind.choices)}"
        facts = "; ".join(fact for fact in ("" if self.by_unit else valid, default and f"default {default}") if fact)
        return f"{self.option.help} {facts[0].upper()}{facts[1:]}." if facts else self.option.help

    def _default(self) -> str:
        """Return the default as a text of this option; "" for none."""
        values = [field.default for field in self.fields.values()]
        if self.by_unit or self.kind.base is bool or any(value is None for value in values):
            return ""
        flat = [each for value in values for each in (value if isinstance(value, tuple) else (value,))]
        return self.option.separator.join(f"{each:g}" if isinstance(each, float) else str(each) for each in flat)


def flag(name: str) -> str:
    """Return the option of the command line: `--max-views` for `max_views`."""
    return f"--{name.replace('_', '-')}"


@cache
def option_specs(model: type[BaseModel], *names: str) -> Mapping[str, OptionSpec]:
    """Return the options of the fields of a model and its tables, by name: all, or only the given names."""
    specs: dict[str, OptionSpec] = {}
    for key, field, option in _option_fields(model):
        name = option.name or _UNIT.sub("", key.rpartition(".")[2])
        earlier = specs[name].fields if name in specs else {}
        specs[name] = OptionSpec(name, option, {**earlier, key: field})
    return {name: specs[name] for name in names or specs}


def parse_options(model: type[Model], options: Mapping[str, object], spell: Spell = str) -> Model:
    """Create a model from options; fields without an option keep their defaults.

    Args:
        model: type with `Option` fields.
        options: texts or values by name; None is no value.
        spell: spelling of names in messages.

    Raises:
        UsageError: if a name is unknown or a value is invalid.
    """
    values = option_values(model, options, spell)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        names = {key: spell(spec.name) for spec in option_specs(model).values() for key in spec.fields}
        raise UsageError("; ".join(error_messages(error, model, names))) from error


def option_values(model: type[BaseModel], options: Mapping[str, object], spell: Spell = str) -> dict[str, object]:
    """Return the values of a model's fields by key, not validated by the model; arguments as of `parse_options`.

    Raises:
        UsageError: if a name is unknown, or a text has not the form of its field.
    """
    known, values = option_specs(model), dict[str, object]()
    for name, value in options.items():
        require_known(name, known, spell)
        if value is None:
            continue
        try:
            values |= _field_values(known[name], value)
        except (ValueError, TypeError, LookupError):
            raise UsageError(_refusal(known[name], value, spell(name))) from None
    return values


def require_known(name: str, known: Iterable[str], spell: Spell = str) -> None:
    """Refuse an unknown option.

    Raises:
        UsageError: with the most similar option, and all of them.
    """
    if name not in (names := list(known)):
        hint = did_you_mean(name, names)
        raise UsageError(f"there is no option {spell(name)}; {hint}there are {', '.join(map(spell, names))}")


def _option_fields(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo, Option]]:
    for key, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _option_fields(field.annotation, f"{prefix}{key}.")
        yield from ((prefix + key, field, option) for option in field.metadata if isinstance(option, Option))


def _kind(annotation: Any, metadata: Sequence[object]) -> Kind:
    """Return the type of an annotation, without None and tuples."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inner[0], (*metadata, *inner[1:]))
    if origin in (Union, UnionType):
        return _kind(next(each for each in inner if each is not NoneType), metadata)
    if origin is tuple:
        one = _kind(inner[0], ())
        return Kind(one.base, -1 if inner[1:] == (...,) else len(inner), one.choices, one.limits)
    if origin is Literal:
        return Kind(str, choices=tuple(map(str, inner)))
    return Kind(annotation, limits=_limits(metadata))


def _limits(metadata: Sequence[object]) -> str:
    """Return limits in words: "above 0 to 1", "at least 4"."""
    flat = [item for each in metadata for item in (each.metadata if isinstance(each, FieldInfo) else [each])]
    bounds = {word: getattr(each, word) for each in flat for word in ("gt", "ge", "lt", "le") if hasattr(each, word)}
    low = f"above {bounds['gt']:g}" if "gt" in bounds else f"{bounds['ge']:g}" if "ge" in bounds else ""
    high = (
        f"below {bounds['lt']:g}" if "lt" in bounds else f"{bounds['le']:g}" if bounds.get("le", _MANY) < _MANY else ""
    )
    if low and high:
        return f"{low} to {high}"
    return f"at least {low}" if "ge" in bounds else low


def _field_values(spec: OptionSpec, argument: object) -> dict[str, object]:
    """Return the values of an option by key; ValueError, TypeError or LookupError for one of another form."""
    value: Any = argument.tolist() if hasattr(argument, "tolist") else argument  # arrays and numbers of NumPy
    option, kinds, keys = spec.option, spec.kinds, list(spec.fields)
    if isinstance(value, Path) and kinds[0].base is str:
        value = str(value)
    if isinstance(value, str):
        value = _parsed(spec, value)
    if spec.by_unit:
        key_of = {key.rpartition("_")[2]: key for key in keys}
        scaled = {unit: _SCALES.get(unit, (unit, 1.0)) for unit in dict(value)}
        return {key_of[ending]: value[unit] * scale for unit, (ending, scale) in scaled.items()}
    if not kinds[0].length and not option.counts:
        return {keys[0]: value}
    several = [value] if isinstance(value, str) or not isinstance(value, Sequence) else list(value)
    if option.counts and len(several) not in option.counts:
        raise ValueError
    if option.convert is not None:
        several = list(option.convert(several))
    if len(keys) == 1:
        return {keys[0]: several}
    values: dict[str, object] = {}
    for key, kind in zip(keys, kinds, strict=True):
        parts, several = several[: kind.length or 1], several[kind.length or 1 :]
        if parts:
            values[key] = parts if kind.length else parts[0]
    return values


def _parsed(spec: OptionSpec, text: str) -> Any:
    """Convert a text to the value that Python code would pass."""
    kind, option = spec.kind, spec.option
    if spec.by_unit:
        pieces = [re.fullmatch(r"(.*?)\s*(%|[a-z]+2?)", piece.strip()) for piece in text.split(",")]
        values = {piece[2]: float(piece[1]) for piece in pieces if piece}
        if len(values) < len(pieces):  # one without a unit, or with another's
            raise ValueError
        return values
    if kind.base not in (int, float):
        return text
    if kind.length or option.counts:
        return [kind.base(piece) for piece in text.split(option.separator)]
    return kind.base(text)


def _refusal(spec: OptionSpec, value: object, name: str) -> str:
    """Return the message for a value of another form."""
    option, numbers = spec.option, "whole numbers" if spec.kind.base is int else "numbers"
    form = option.form or (f"{numbers} separated by commas" if spec.kind.length else f"a {numbers[:-1]}")
    examples = " or ".join(f"{name} {example}" for example in option.examples)
    return f"{name} {value} must be {form}" + (f", for instance {examples}" if examples else "")
