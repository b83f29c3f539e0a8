"""Rows of M added where a plan turned out to need them, and the area that each row stands for then."""

from dataclasses import replace

import numpy as np

from planner.errors import PlannerError
from planner.measurability.matrix import Measurability
from planner.surface.sample import join_samples
from planner.values import Floats


def add_rows(measurability: Measurability, more: Measurability, face_areas: Floats) -> Measurability:
    """M with further features below its own.

    All features of a planning face share its area equally, so that many on one face do not make it larger. All areas
    together stay what they were.

    Args:
        measurability: M.
        more: the same columns over other features, with sigma where M has it.
        face_areas: (F,) area of the surface that belongs to each planning face, in any unit; above zero where there is
            a feature.

    Raises:
        PlannerError: if the columns differ, or only one of the two has sigma.
    """
    if measurability.n_viewpoints != more.n_viewpoints:
        raise PlannerError(
            f"rows of {more.n_viewpoints} viewpoints cannot be added to M of {measurability.n_viewpoints}; fill them "
            "for the same candidates"
        )
    if (measurability.sigma is None) != (more.sigma is None):
        raise PlannerError("only one of the matrices has a layer of sigma; calculate it for both")
    own, new = measurability.features, more.features
    features = join_samples([own, new])
    number = np.bincount(features.planning_face)
    areas = (face_areas[: len(number)] / np.maximum(number, 1))[features.planning_face]
    sigma = None
    if measurability.sigma is not None and more.sigma is not None:
        sigma = np.concatenate([measurability.sigma, more.sigma])
    return Measurability(
        np.concatenate([measurability.indptr, measurability.indptr[-1] + more.indptr[1:]]),
        np.concatenate([measurability.indices, more.indices]),
        replace(features, areas=areas * (own.areas.sum() / areas.sum())),
        measurability.n_viewpoints,
        sigma,
    )
