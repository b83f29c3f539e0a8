"""Compute the digest of a plan: a person confirms it, and programs and executions carry it.

It is the sha256 of a text with one line for each driving artefact, sorted by name: the file's sha256 in hexadecimal,
two spaces, its name, a line feed. It can be checked without this project:

    LC_ALL=C sha256sum cell.xml motion.npz plan.json reference.ply scene.resolved.json viewpoints.npz | sha256sum

with `fixture_<name>.ply` of each mesh fixture and `robot.xml`, if there are any, sorted among them.

A path that differs from the plan's motion has its own digest, over the line `plan <digest of the plan>` and one
line for each via point in driving order, from the current position of the arm: the number of the move, of the view that
is scanned at its end and of its pose (0 and -1 for none), and the set-points of all axes in counts of 1e-4 deg,
separated by single spaces.
"""

import hashlib
from collections.abc import Iterable, Mapping

DRIVING_ARTEFACTS = ("cell.xml", "motion.npz", "plan.json", "reference.ply", "scene.resolved.json", "viewpoints.npz")
"""Artefacts that define every motion: cell, motion, views, part, settings, candidates."""

SHORT_DIGEST = 8
"""Number of characters of a digest in messages, and the minimum in a confirmation."""


def driving_artefacts(artefacts: Iterable[str]) -> list[str]:
    """Return the sorted names of the artefacts that define a motion, mesh fixtures and robot file included."""
    fixtures = (name for name in artefacts if name.startswith("fixture_") and name.endswith(".ply"))
    return sorted({*DRIVING_ARTEFACTS, *fixtures, *(name for name in artefacts if name == "robot.xml")})


def plan_digest(artefacts: Mapping[str, str]) -> str:
    """Return the digest of a plan from the sha256 of its artefacts."""
    return _sha256(f"{artefacts[name]}  {name}" for name in driving_artefacts(artefacts))


def path_digest(plan: str, points: Iterable[Iterable[int]]) -> str:
    """Return the digest of a path other than the plan's motion.

    Args:
        plan: digest of the plan.
        points: integers for each via point: move, view, pose, set-points of all axes in counts of 1e-4 deg.
    """
    return _sha256([f"plan {plan}", *(" ".join(str(int(number)) for number in point) for point in points)])


def _sha256(lines: Iterable[str]) -> str:
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()
