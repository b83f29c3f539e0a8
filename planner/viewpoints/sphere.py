"""The view sphere: viewpoints on a sphere about the part, all looking at its middle (Section 3.4.1)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import PlannerError
from planner.values import readonly
from planner.viewpoints.viewpoints import Viewpoints, looking_at


def view_sphere(
    centre: ArrayLike, radius: float, step_x: float, step_y: float, rolls: Sequence[float] = (0.0,)
) -> Viewpoints:
    """Viewpoints on a sphere about a point, all looking at it.

    The direction out of the centre is +z, turned about x by multiples of `step_x` from -90 to 90 degrees and then about
    y by multiples of `step_y` below 360 degrees. The poles (on the y axis), which every turn about y leaves where they
    are, are there once: 15 degree steps give 11 x 24 + 2 = 266 directions.

    Args:
        centre: (3,) point to look at [m], object frame.
        radius: of the sphere [m]; it must enclose the part, see `enclosing_radius`.
        step_x: resolution of the turn about x [rad], in (0, pi].
        step_y: resolution of the turn about y [rad], in (0, pi].
        rolls: angles about the viewing axis [rad].

    Raises:
        PlannerError: if the radius is not positive, a step is outside its range, or there is no roll.
    """
    if not (radius > 0 and np.isfinite(radius)):
        raise PlannerError(f"radius is {radius:g} m; it must be above 0 and finite")
    for name, step in (("step_x", step_x), ("step_y", step_y)):
        if not 0 < step <= np.pi:
            raise PlannerError(f"{name} is {step:g} rad; it must be above 0 and at most pi")
    n_x = int(np.floor(np.pi / 2 / step_x + 1e-9))
    n_y = int(np.ceil(2 * np.pi / step_y - 1e-9))
    about_x, about_y = np.meshgrid(np.arange(-n_x, n_x + 1) * step_x, np.arange(n_y) * step_y, indexing="ij")
    pole = np.abs(np.cos(about_x)) < 1e-9
    once = ~pole | (about_y == 0)
    a, b = about_x[once], about_y[once]
    outward = np.stack([np.cos(a) * np.sin(b), -np.sin(a), np.cos(a) * np.cos(b)], axis=1)  # Ry(b) Rx(a) e_z
    middle = np.broadcast_to(readonly("centre", centre, (3,)), outward.shape)
    return looking_at(middle, outward, np.full(len(outward), -1), [radius], rolls)
