"""Rows of M added where a plan turned out to need them, and the area that each row stands for then."""

from dataclasses import replace

import numpy as np

from planner.errors import PlannerError
from planner.measurability.matrix import Measurability
from planner.surface.sample import SurfaceSamples, join_samples
from planner.values import Ints


def add_rows(measurability: Measurability, more: Measurability, spread: SurfaceSamples) -> Measurability:
    """M with further features below its own.

    All features of a planning face (of a region on it, where the part has regions) share its area equally, so that many
    on one face make neither it nor a region larger. All areas together stay what they were.

    Args:
        measurability: M.
        more: the same columns over other features, with sigma where M has it.
        spread: samples all over the surface, which say how large each face, or a region on it, is; one that none of
            them lies on is as large as what one of them stands for.

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
    piece, piece_of_spread = _pieces(features, spread)
    number = np.bincount(piece)
    area = np.bincount(piece_of_spread, weights=spread.areas, minlength=len(number))[: len(number)]
    areas = (np.maximum(area, spread.areas.min()) / np.maximum(number, 1))[piece]
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


def _pieces(*samples: SurfaceSamples) -> list[Ints]:
    """(S,) for each of several samples: a number of the planning face and the region that a sample lies on."""
    regions = [each.region for each in samples if each.region is not None]
    if len(regions) < len(samples):
        return [each.planning_face.astype(np.int64) for each in samples]
    count = 1 + max(int(region.max()) for region in regions)
    return [each.planning_face * np.int64(count) + region for each, region in zip(samples, regions, strict=True)]
