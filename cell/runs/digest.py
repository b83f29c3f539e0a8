"""One digest over all that drives: what a person confirms, what a program and every execution say they were made of.

It is the sha256 of a text with one line for each file that the motion rests on, in the order of their names' bytes: the
file's sha256 in hexadecimal, two spaces, its name, a line feed. So `sha256sum` of these files, sorted by name, piped
into `sha256sum` again gives it, without any of our code:

    LC_ALL=C sha256sum cell.xml motion.npz plan.json reference.ply scene.resolved.json viewpoints.npz | sha256sum

with `fixture_<name>.ply` of each mesh fixture, and `robot.xml` where there is one, in their places among them. The
files are hashed as the bytes that they are; their form is canonical because equal inputs and seed give equal bytes.

A way that is not the plan's motion as a whole has a digest of its own: of the text `plan <digest of the plan>`, then
one line for each via point in driving order, from where the arm stands: the number of the leg, of the view that is
scanned at the leg's end and of its pose (0 and -1 for none), and the set-points of all axes in counts of 1e-4 deg, with
single spaces between. So it says which plan the way belongs to as well.
"""

import hashlib
from collections.abc import Iterable, Mapping

DRIVING_ARTEFACTS = ("cell.xml", "motion.npz", "plan.json", "reference.ply", "scene.resolved.json", "viewpoints.npz")
"""Artefacts that every motion rests on: the cell, the way, the views, the part, the settings, the candidates."""

SHORT_DIGEST = 8
"""Characters of a digest that are shown, and asked for at least."""


def driving_artefacts(artefacts: Iterable[str]) -> list[str]:
    """Names of the artefacts that the motion rests on, sorted: `ALWAYS`, triangles of mesh fixtures, a robot's file."""
    fixtures = (name for name in artefacts if name.startswith("fixture_") and name.endswith(".ply"))
    return sorted({*DRIVING_ARTEFACTS, *fixtures, *(name for name in artefacts if name == "robot.xml")})


def plan_digest(artefacts: Mapping[str, str]) -> str:
    """The digest of a plan.

    Raises:
        KeyError: if one that drives is missing.
    """
    return _sha256(f"{artefacts[name]}  {name}" for name in driving_artefacts(artefacts))


def path_digest(plan: str, points: Iterable[Iterable[int]]) -> str:
    """The digest of a way of its own.

    Args:
        plan: digest of the plan.
        points: a row of whole numbers for each via point: leg, view and pose that are taken there, set-points of all
            axes in counts of 1e-4 deg.
    """
    return _sha256([f"plan {plan}", *(" ".join(str(int(number)) for number in point) for point in points)])


def _sha256(lines: Iterable[str]) -> str:
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()
