"""Reasons why MuJoCo refuses a description, in words of this program: place, cause, cure."""

import re

_CAUSES: tuple[tuple[str, str], ...] = (
    (
        r"inertia must satisfy",
        "an inertia is impossible, no principal moment may exceed the sum of the other two; correct its <inertial>",
    ),
    (r"inertia must have positive", "an inertia is impossible, its principal moments are not positive; correct it"),
    (r"mass and inertia of moving bodies", "a moving body has no mass or inertia; give it an <inertial>"),
    (r"mass, inertia or density are negative", "a mass, inertia or density is negative; correct it"),
    (r"fullinertia and diagonal", "an inertia is given twice, as a diagonal and as a matrix; remove one"),
    (r"size \d must be positive|nan size", "a shape has a size that is missing or not above 0; give all its sizes"),
    (r"fromto points too close", "the two ends of a shape are at the same point; move one of them"),
    (r"plane only allowed in static", "a link that moves has a plane as its shape; give it a box"),
    (r"coplanar vertices", "a mesh is flat; use a thin box in its place"),
    (r"at least 4 vertices", "a mesh has fewer than four corners, or is broken; export it again, or use a box"),
    (r"mesh (surface area|volume) is too small", "a mesh has no volume; correct its scale, or use a box"),
    (r"vertex coordinate \d+ is not finite", "a mesh has a coordinate that is not a number; export it again"),
    (
        r"data must be a multiple of 3|vertex index .* does not exist",
        "the corners of a mesh are incomplete; correct it",
    ),
    (
        r"decoder: .*file '([^']*)'",
        "the mesh '{0}' is broken, text, or has more than 200,000 faces; convert it to a smaller binary STL",
    ),
    (r"no decoder found for \w+ file '([^']*)'", "'{0}' is no mesh that MuJoCo reads; convert it to binary STL"),
    (r"opening file '([^']*)'", "'{0}' cannot be opened; correct its name or folder"),
    (r"free joint can only|more than 6 dofs", "a link within the arm has a free joint; remove it"),
    (r"already included", "it includes itself; remove the <include>"),
    (r"decoding PNG file '([^']*)'", "the picture '{0}' cannot be read; remove it, only shapes are needed"),
    (
        r"\b(?:mesh|hfield|material|joint|body|element|target|name|model|class name) '([^']*)'"
        r"(?: not found| of sensorized| in equality| for actuator|$)",
        "it refers to '{0}', which it does not define; correct this name",
    ),
    (r"must have valid meshid", "a shape of the type mesh names no mesh; name one"),
    (r"axis too small", "the axis of a joint has no length; give it a direction"),
    (r"range\[0\] should be smaller", "the range of a joint is empty or reversed; correct it"),
    (r"repeated (?:URDF )?name:? ?'?([^' ]+)", "the name '{0}' is given twice; rename one"),
    (r"multiple parents", "a link has two parents; the links of a URDF must form a tree"),
    (r"URDF body not found", "no link is without a parent; the links of a URDF must form a tree"),
    (r"parent or child missing", "a joint names a parent or a child that does not exist; correct it"),
    (r"missing element: '(\w+)'", "<{0}> is missing; add it"),
    (r"invalid joint type", "a joint has an unknown type; valid are revolute, continuous, prismatic and fixed"),
    (r"geometry specification not found", "a shape is unknown; valid are box, cylinder, sphere, capsule and mesh"),
    (r"required attribute missing: '(\w+)'", "'{0}' is missing; add it"),
    (r"attribute '(\w+)' does not have enough", "'{0}' has too few numbers; add them"),
    (r"attribute '(\w+)' has too much", "'{0}' has too many numbers; remove them"),
    (r"(?:bad format|too large).* attribute '(\w+)'", "'{0}' is not a valid number; correct it"),
    (r"invalid keyword: '([^']*)'", "'{0}' is not a valid value; correct it"),
    (r"unrecognized attribute: '(\w+)'", "'{0}' is an unknown attribute; remove it"),
    (r"unrecognized element", "this element is unknown here; remove it"),
    (r"zero quaternion", "a quaternion has no length; correct it"),
    (r"multiple orientation specifiers", "an orientation is given twice; remove one"),
    (r"default class name|empty class name", "the name of a default class is missing, or given twice; correct it"),
    (r"global coordinates", "it uses global coordinates; convert it with MuJoCo 2.3.3"),
    (r"plugin (\S+) not found", "it needs the MuJoCo plug-in {0}; remove it"),
    (r"ELEMENT_DEPTH", "its elements are nested too deeply; correct it"),
)
"""Pattern of MuJoCo's words, and our sentence with its groups."""


def describe_refusal(error: ValueError, *, has_lines: bool = True) -> str:
    """Return place, cause and cure of a description that MuJoCo refuses.

    Args:
        error: MuJoCo's.
        has_lines: whether its line numbers are those of the user's file.
    """
    words = " ".join(str(error).split())
    words = words if has_lines else re.sub(r", line \d+", "", words)
    sentence, _, element = words.partition(" Element ")
    cause, place = _cause(re.sub(r"^(?:(?:XML )?Error: )*", "", sentence)), _place(sentence, element)
    return f"{place}: {cause}" if place else cause


def _cause(sentence: str) -> str:
    for pattern, ours in _CAUSES:
        if match := re.search(pattern, sentence):
            return ours.format(*(group.strip()[:60] for group in match.groups()))
    return f"MuJoCo's compiler reports '{sentence[:120]}'; correct or remove this element"


def _place(sentence: str, element: str) -> str:
    """Return kind, name and line of the element that MuJoCo names."""
    line = re.search(r"line (\d+)", element)
    at = f"line {line[1]}" if line and line[1] != "1" else ""
    if match := re.match(r"name '([^']*)', id (\d+)", element):
        kind = re.search(r" in (geom|joint|body|light|camera|site)\b", sentence)
        which = f"{kind[1] if kind else 'element'} "
        return ", ".join(
            each for each in (which + (f"'{match[1]}'" if match[1] else f"number {int(match[2]) + 1}"), at) if each
        )
    tag = re.match(r"'(\w+)'", element)
    return ", ".join(each for each in (f"<{tag[1]}>" if tag else "", at) if each)
