"""Surface that two set-ups share, and whether it fixes their scans relative to each other.

The remaining freedom decides, not the area: a shared plane leaves three free motions.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np

from cell.runs.schema import CommonSurface
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.registration.observability import FreeMotion, describe, free_motions_of_surface
from planner.values import Bools, Ints

_N_TRIED = 200  # views that are tried to connect two set-ups, those with the largest shared area first


def shared_surfaces(seen: Mapping[int, Bools], samples: SurfaceSamples) -> tuple[CommonSurface, ...]:
    """Return the shared surface of each pair of set-ups.

    Args:
        seen: for each set-up, by number, (S,) whether its views measure each sample.
        samples: of the surface, of equal area.
    """
    return tuple(
        CommonSurface(
            setups=(one, other),
            share=float((seen[one] & seen[other]).mean()),
            free_motions=(describe(free),) if (free := remaining_freedom(seen[one], seen[other], samples)) else (),
        )
        for one, other in combinations(sorted(seen), 2)
    )


def remaining_freedom(one: Bools, other: Bools, samples: SurfaceSamples) -> tuple[FreeMotion, ...]:
    """Return the motions of one set-up relative to another that their shared surface does not show.

    None if all measured surface shows no more: a ball that both measure turns freely, and nothing is lost.
    """
    both, either = one & other, one | other
    free = free_motions_of_surface(samples.points[both], samples.normals[both])
    least = free_motions_of_surface(samples.points[either], samples.normals[either])
    return free if len(free) > len(least) else ()


def unconnected_setups(pairs: Iterable[CommonSurface], numbers: Sequence[int]) -> tuple[int, ...]:
    """Return the set-ups that no chain of fixed pairs connects to the first."""
    connected, pairs = set(list(numbers)[:1]), tuple(pairs)
    for _ in numbers:
        connected |= {
            each for pair in pairs if not pair.free_motions and connected & set(pair.setups) for each in pair.setups
        }
    return tuple(number for number in numbers if number not in connected)


def connecting_view(
    M: Mapping[int, Measurability], usable: Mapping[int, Bools], views: Mapping[int, Ints]
) -> tuple[int, int] | None:
    """Return a set-up and a candidate of it that connects two unconnected set-ups; None if none is needed or helps.

    Args:
        M: of each set-up, over the same rows.
        usable: for each, (V,) candidates that may be selected.
        views: selected candidates of each used set-up.
    """
    matrices = {row: M[row].matrix().tocsc() for row in views}
    samples = M[next(iter(views))].samples
    seen = {row: np.asarray(matrices[row][:, columns].sum(axis=1)).ravel() > 0 for row, columns in views.items()}
    alone = set(unconnected_setups(shared_surfaces(seen, samples), tuple(views)))
    for here in sorted(alone):
        for there in sorted(set(views) - alone):
            for one, other in ((here, there), (there, here)):
                free = np.flatnonzero(usable[one])
                gain = (samples.areas * (seen[other] & ~seen[one])) @ matrices[one][:, free]
                for column in free[np.argsort(-gain, kind="stable")[:_N_TRIED]]:
                    more = seen[one] | (np.asarray(matrices[one][:, [column]].todense()).ravel() > 0)
                    if not remaining_freedom(more, seen[other], samples):
                        return one, int(column)
    return None
