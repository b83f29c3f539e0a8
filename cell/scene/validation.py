"""Messages about scene files: errors of pydantic in plain words, and notes on settings beyond the tested range.

An error names the key, the wrong value and the valid values. The limits of the notes are the borders of the maps in
docs/internals/stability.md.
"""

import difflib
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

if TYPE_CHECKING:
    from planner.geometry.mesh import TriangleMesh
    from planner.geometry.sampling import SurfaceSamples
    from planner.ports import Scanner

STEEPEST_GRAZING_DEG = 77.0
"""Largest grazing angle at which a scan still has points: at steeper angles the measured surface is overestimated."""

COARSEST_MESH = 0.01
"""Largest good distance of 95 % of the surface from the planning mesh, as a share of the mesh's diagonal.

Candidates of a coarser mesh miss surface that those of a finer mesh measure.
"""

_COMPARISONS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
_REQUIRED = {
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
}
_FORMS = {
    r"^(low|normal|high|\d+)$": "low, normal, high, or a number of poses",
    r"^#[0-9A-Fa-f]{6}$": "a colour as '#rrggbb'",
    r"^[A-Z]{1,2}$": "one or two capital letters",
    r"^[^|\r\n]*$": "a name in one line, without |",
}
"""Forms of texts by their pattern; all others are names of files."""
_KEY = re.compile(r"\b\w+(?:\.\w+)+|^\w+")  # keys in a message: the first word, and words with a dot


def error_messages(error: ValidationError, model: type[BaseModel], names: Mapping[str, str] | None = None) -> list[str]:
    """Convert an error of pydantic to one message a problem.

    Args:
        error: raised by `model`.
        model: the outermost table.
        names: user's spelling of keys that do not come from the file, such as "--faces" for "plan.faces".
    """
    details = error.errors()
    lengths: dict[tuple[int | str, ...], int] = {}  # of lists that are too short: pydantic reports each missing item
    for detail in details:
        if detail["type"] == "missing" and isinstance(detail["loc"][-1], int):
            lengths[detail["loc"][:-1]] = max(lengths.get(detail["loc"][:-1], 0), detail["loc"][-1] + 1)
    messages = []
    for detail in details:
        message = _message(detail, model, lengths)
        if names:
            message = _KEY.sub(lambda key: names.get(key[0], key[0]), message)
        if message not in messages:
            messages.append(message)
    return messages


def did_you_mean(word: object, known: Sequence[str]) -> str:
    """Return "did you mean 'x'? " for a similar known word, else ""."""
    close = difflib.get_close_matches(str(word).lower(), known, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'? " if close else ""


def _message(detail: ErrorDetails, model: type[BaseModel], lengths: Mapping[tuple[int | str, ...], int]) -> str:
    kind, loc, value, context = detail["type"], detail["loc"], detail.get("input"), detail.get("ctx", {})
    keys, owner = _keys_and_table(loc, model)
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
        return f"{where} is {_toml(value)}; {did_you_mean(value, known)}valid are: {', '.join(known)}"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        known = [tag for field in model.model_fields.values() for tag in _tables_by_shape(field.annotation)]
        if kind == "union_tag_not_found":
            return f"{where}.shape is missing; valid are: {', '.join(known)}"
        tag = context["tag"]
        return f"{where}.shape is '{tag}'; {did_you_mean(tag, known)}valid are: {', '.join(known)}"
    if kind in _COMPARISONS:
        key, word = _COMPARISONS[kind]
        return f"{where} is {_toml(value)}; it must be {word} {context[key]:g}"
    if kind == "value_error":
        text = str(context["error"])  # a validator of a table names the key itself: ".key is ..."
        return (where + text).removeprefix(".") if text.startswith(".") else f"{where} {text}"
    if kind == "string_pattern_mismatch":
        form = _FORMS.get(context["pattern"], "a name of letters, digits, spaces, '_', '-' and '.'")
        return f"{where} is {_toml(value)}; it must be {form}"
    if kind in _REQUIRED:
        return f"{where} is {_toml(value)}; it must be {_REQUIRED[kind]}"
    return f"{where} is {_toml(value)}, which is not valid"


def _keys_and_table(
    loc: tuple[int | str, ...], model: type[BaseModel]
) -> tuple[list[int | str], type[BaseModel] | None]:
    """Return the keys as in the file (pydantic adds the tag of a union), and the table that has the last one."""
    keys: list[int | str] = []
    owner: type[BaseModel] | None = model
    annotation: Any = model
    for step in loc:
        by_shape = _tables_by_shape(annotation)
        if keys and isinstance(keys[-1], int) and step in by_shape:
            annotation = owner = by_shape[str(step)]
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
    """Return every model class inside an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _models(inner)]


def _tables_by_shape(annotation: Any) -> dict[str, type[BaseModel]]:
    """Return the classes of a union that differ by their `shape`."""
    classes = [model for model in _models(annotation) if "shape" in model.model_fields]
    return {str(get_args(model.model_fields["shape"].annotation)[0]): model for model in classes}


def _path(keys: Sequence[int | str]) -> str:
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


def _toml(value: object) -> str:
    """Write a value as in TOML, at most 60 characters."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def grazing_note(limit_deg: float) -> str:
    """Describe a grazing limit above `STEEPEST_GRAZING_DEG`; "" for a good limit."""
    if limit_deg <= STEEPEST_GRAZING_DEG:
        return ""
    return (
        f"scanner.grazing_max_deg is {limit_deg:g}: surface at more than {STEEPEST_GRAZING_DEG:g} deg to the rays "
        "counts as measured, but scan points are so sparse there that it is hardly captured"
    )


def sweep_note(scanner: "Scanner") -> str:
    """Describe the views of a scanner that sweeps; "" for any other."""
    T_view_scanner = getattr(scanner, "T_view_scanner", None)
    if T_view_scanner is None:
        return ""
    return (
        f"each view is a sweep of {len(T_view_scanner)} poses along a line; occlusion by the arm itself is not checked "
        "along the sweep"
    )


def mesh_deviation(samples: "SurfaceSamples", planning: "TriangleMesh") -> float:
    """Return the distance of 95 % of the samples from the planes of their planning faces, as a share of the diagonal.

    The centres of the planning faces themselves (`fill = "rays"`) have distance 0.
    """
    import numpy as np  # the start-up of the command line does without it

    offset = samples.points - planning.centres[samples.planning_face]
    height = np.abs(np.einsum("nj,nj->n", offset, planning.normals[samples.planning_face]))
    return float(np.quantile(height, 0.95) / planning.diagonal)


def face_count_note(n_faces: int, requested: int) -> str:
    """Describe a planning mesh whose number of faces differs from the requested number; "" for a small difference."""
    if abs(n_faces - requested) <= max(2, 0.02 * requested):
        return ""
    return (
        f"the planning mesh has {n_faces} faces instead of {requested}: this part cannot be decimated closer (sliver "
        "triangles, several bodies, or fewer faces than requested); the plan uses these"
    )


def coarse_mesh_note(deviation: float, n_faces: int) -> str:
    """Describe a coarse planning mesh by its `mesh_deviation`; "" for a fine one."""
    if deviation <= COARSEST_MESH:
        return ""
    return (
        f"the planning mesh of {n_faces} faces is coarse: 5 % of the surface is {100 * deviation:.1f} % of the part's "
        f"diagonal or more away from it, above {100 * COARSEST_MESH:g} %; its candidates miss surface; increase --faces"
    )
