"""Options from fields: what a command line and Python accept is read off the fields of pydantic models.

A field is offered by an `Option` in its annotation. Type, unit, limits, choices and default are the field's own; the
option says what it is for. Fields that share a name are one option: its values are dealt to them in order
(`--place x,y,z,A,B,C`), or each value has a unit that says whose it is (`--pose-sd 0.5mm,0.1deg`).
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from cell.errors import UsageError
from cell.scene.validation import did_you_mean, error_messages

Spell = Callable[[str], str]
"""Writes the name of an option as its user does: `flag` for the command line, `str` for a keyword of Python."""

Model = TypeVar("Model", bound=BaseModel)

_UNIT = re.compile(r"_(mm2|mm|deg|percent|share)$")
_METAVARS = {"mm": "MM", "deg": "DEG", "percent": "PERCENT"}
_MANY = 1e9  # nobody comes near such a limit
_SCALES = {"%": ("share", 0.01)}  # other units are the ends of the keys that they fill


@dataclass(frozen=True, slots=True)
class Option:
    """Offers a field on the command line, and to Python as a keyword.

    Attributes:
        help: what it is for, a sentence; limits, choices and default follow of themselves.
        panel: heading under which `--help` shows it; "" for none.
        name: the keyword, where it is not the key without its unit.
        also: another flag for it.
        metavar: what stands for its value in `--help`, where unit and type do not say it.
        form: what a text for it must be, for the sentence that refuses one, where its type does not say it.
        examples: of such texts.
        counts: how many values it may have; with more than one field they are dealt in order.
        separator: between its values.
        made: its value of those values; raises ValueError where they cannot be.
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
    made: Callable[[Sequence[Any]], Sequence[Any]] | None = None


@dataclass(frozen=True, slots=True)
class Kind:
    """What a field's annotation says.

    Attributes:
        base: bool, int, float or another type; str where there are choices.
        length: values of a tuple; 0 for a single one, -1 for any number.
        choices: of which it must be one.
        limits: words such as "above 0 to 1".
    """

    base: type
    length: int = 0
    choices: tuple[str, ...] = ()
    limits: str = ""


@dataclass(frozen=True, slots=True)
class OptionSpec:
    """An option and the fields that it fills, by their keys ("plan.faces"), in order."""

    name: str
    option: Option
    fields: Mapping[str, FieldInfo]

    @property
    def kinds(self) -> list[Kind]:
        """What the annotation of each field says."""
        return [_kind(field.annotation, field.metadata) for field in self.fields.values()]

    @property
    def kind(self) -> Kind:
        """Of the first field: several fields of one option differ in length only."""
        return self.kinds[0]

    @property
    def by_unit(self) -> bool:
        """Whether a value's unit says which field it fills."""
        return len(self.fields) > 1 and not self.option.counts

    @property
    def metavar(self) -> str | None:
        """What stands for the value in `--help`; None for a switch."""
        kind, unit = self.kind, _UNIT.search(next(iter(self.fields)))
        if kind.base is bool or self.option.metavar:
            return self.option.metavar or None
        one = _METAVARS.get(unit[1] if unit else "", {int: "N", float: "X"}.get(kind.base, "NAME"))
        return f"{one}[,{one}...]" if kind.length else one

    @property
    def help(self) -> str:
        """What it is for, its limits or choices, and its default."""
        kind, default = self.kind, self._default()
        named = all(choice in self.option.help for choice in kind.choices)
        valid = kind.limits if named else f"one of {', '.join(kind.choices)}"
        said = "; ".join(fact for fact in ("" if self.by_unit else valid, default and f"default {default}") if fact)
        return f"{self.option.help} {said[0].upper()}{said[1:]}." if said else self.option.help

    def _default(self) -> str:
        """The default as a text of this option; "" where the field has none to show."""
        values = [field.default for field in self.fields.values()]
        if self.by_unit or self.kind.base is bool or any(value is None for value in values):
            return ""
        flat = [each for value in values for each in (value if isinstance(value, tuple) else (value,))]
        return self.option.separator.join(f"{each:g}" if isinstance(each, float) else str(each) for each in flat)


def flag(name: str) -> str:
    """The option of the command line: `max_views` is `--max-views`."""
    return f"--{name.replace('_', '-')}"


@cache
def option_specs(model: type[BaseModel], *names: str) -> Mapping[str, OptionSpec]:
    """What the fields of a model, and of the tables in it, offer by name: all of it, or only those named."""
    found: dict[str, OptionSpec] = {}
    for key, field, option in _offered(model):
        name = option.name or _UNIT.sub("", key.rpartition(".")[2])
        earlier = found[name].fields if name in found else {}
        found[name] = OptionSpec(name, option, {**earlier, key: field})
    return {name: found[name] for name in names or found}


def parse_options(model: type[Model], wishes: Mapping[str, object], spell: Spell = str) -> Model:
    """A model of wishes; fields that nobody wishes keep their defaults.

    Args:
        model: whose fields are offered.
        wishes: texts or values by name; None is no wish.
        spell: how the user writes a name.

    Raises:
        UsageError: if a name is unknown or a value cannot be.
    """
    filled = option_values(model, wishes, spell)
    try:
        return model.model_validate(filled)
    except ValidationError as error:
        names = {key: spell(offer.name) for offer in option_specs(model).values() for key in offer.fields}
        raise UsageError("; ".join(error_messages(error, model, names))) from error


def option_values(model: type[BaseModel], wishes: Mapping[str, object], spell: Spell = str) -> dict[str, object]:
    """Values of a model's fields by key, as `read`; the model has not checked them.

    Raises:
        UsageError: if a name is unknown, or a text is not what its field can be made of.
    """
    known, filled = option_specs(model), dict[str, object]()
    for name, wish in wishes.items():
        if name not in known:
            hint = did_you_mean(name, list(known))
            raise UsageError(f"there is no option {spell(name)}; {hint}there are {', '.join(map(spell, known))}")
        if wish is None:
            continue
        try:
            filled |= _filled(known[name], wish)
        except (ValueError, TypeError, LookupError):
            raise UsageError(_refusal(known[name], wish, spell(name))) from None
    return filled


def _offered(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo, Option]]:
    for key, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _offered(field.annotation, f"{prefix}{key}.")
        yield from ((prefix + key, field, option) for option in field.metadata if isinstance(option, Option))


def _kind(annotation: Any, metadata: Sequence[object]) -> Kind:
    """What an annotation says, None and tuples taken off."""
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
    """Limits in words: "above 0 to 1", "at least 4"."""
    flat = [each for told in metadata for each in (told.metadata if isinstance(told, FieldInfo) else [told])]
    found = {word: getattr(each, word) for each in flat for word in ("gt", "ge", "lt", "le") if hasattr(each, word)}
    low = f"above {found['gt']:g}" if "gt" in found else f"{found['ge']:g}" if "ge" in found else ""
    high = f"below {found['lt']:g}" if "lt" in found else f"{found['le']:g}" if found.get("le", _MANY) < _MANY else ""
    if low and high:
        return f"{low} to {high}"
    return f"at least {low}" if "ge" in found else low


def _filled(offer: OptionSpec, wish: object) -> dict[str, object]:
    """Values by key of one wish; ValueError, TypeError or LookupError where it has not the option's form."""
    value: Any = wish.tolist() if hasattr(wish, "tolist") else wish  # numpy's arrays and numbers
    option, kinds, keys = offer.option, offer.kinds, list(offer.fields)
    if isinstance(value, str):
        value = _parsed(offer, value)
    if offer.by_unit:
        fills = {key.rpartition("_")[2]: key for key in keys}
        scaled = {unit: _SCALES.get(unit, (unit, 1.0)) for unit in dict(value)}
        return {fills[ending]: value[unit] * scale for unit, (ending, scale) in scaled.items()}
    if not kinds[0].length and not option.counts:
        return {keys[0]: value}
    several = list(value) if isinstance(value, (list, tuple)) else [value]
    if option.counts and len(several) not in option.counts:
        raise ValueError
    if option.made is not None:
        several = list(option.made(several))
    if len(keys) == 1:
        return {keys[0]: several}
    filled: dict[str, object] = {}
    for key, kind in zip(keys, kinds, strict=True):
        some, several = several[: kind.length or 1], several[kind.length or 1 :]
        if some:
            filled[key] = some if kind.length else some[0]
    return filled


def _parsed(offer: OptionSpec, text: str) -> Any:
    """What Python would give in place of a text."""
    kind, option = offer.kind, offer.option
    if offer.by_unit:
        pieces = [re.fullmatch(r"(.*?)\s*(%|[a-z]+2?)", piece.strip()) for piece in text.split(",")]
        found = {piece[2]: float(piece[1]) for piece in pieces if piece}
        if len(found) < len(pieces):  # one without a unit, or with another's
            raise ValueError
        return found
    if kind.base not in (int, float):
        return text
    if kind.length or option.counts:
        return [kind.base(piece) for piece in text.split(option.separator)]
    return kind.base(text)


def _refusal(offer: OptionSpec, wish: object, name: str) -> str:
    """The sentence for a value that has not the option's form."""
    option, whole = offer.option, "whole numbers" if offer.kind.base is int else "numbers"
    form = option.form or (f"{whole} separated by commas" if offer.kind.length else f"a {whole[:-1]}")
    examples = " or ".join(f"{name} {example}" for example in option.examples)
    return f"{name} {wish} must be {form}" + (f", for instance {examples}" if examples else "")
