"""What two set-ups both measure, and whether it holds their scans together: freedom decides, not area."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np

from cell.runs.schema import SharedSurface
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.registration.observability import FreeMotion, describe, free_motions_of_surface
from planner.values import Bools, Ints

_TRIED = 200  # views that are asked whether they hold two set-ups together, those that share the largest area first


def shared(seen: Mapping[int, Bools], samples: SurfaceSamples) -> tuple[SharedSurface, ...]:
    """What each pair of set-ups shares.

    Args:
        seen: for each set-up, by number, (S,) samples that its views measure.
        samples: of the surface, evenly spread.
    """
    return tuple(
        SharedSurface(
            setups=(one, other),
            share=float((seen[one] & seen[other]).mean()),
            free=(describe(free),) if (free := left_free(seen[one], seen[other], samples)) else (),
        )
        for one, other in combinations(sorted(seen), 2)
    )


def left_free(one: Bools, other: Bools, samples: SurfaceSamples) -> tuple[FreeMotion, ...]:
    """Motions of one set-up against another that the surface which both measure does not show.

    None where all that they measure shows no more: a ball that both see turns as it likes, and nothing is lost by it.
    """
    both, any_ = one & other, one | other
    free = free_motions_of_surface(samples.points[both], samples.normals[both])
    return free if len(free) > len(free_motions_of_surface(samples.points[any_], samples.normals[any_])) else ()


def apart(pairs: Iterable[SharedSurface], numbers: Sequence[int]) -> tuple[int, ...]:
    """Set-ups that no chain of pairs which hold together joins to the first."""
    joined, pairs = set(list(numbers)[:1]), tuple(pairs)
    for _ in numbers:
        joined |= {each for pair in pairs if not pair.free and joined & set(pair.setups) for each in pair.setups}
    return tuple(number for number in numbers if number not in joined)


def joining(
    M: Mapping[int, Measurability], usable: Mapping[int, Bools], views: Mapping[int, Ints]
) -> tuple[int, int] | None:
    """A set-up and a candidate of it that joins two set-ups which nothing holds together; None where none is needed.

    Args:
        M: of each set-up, over the same rows.
        usable: for each (V,) columns that may be chosen.
        views: of each that is used, the chosen columns.
    """
    matrices = {row: M[row].matrix().tocsc() for row in views}
    features = M[next(iter(views))].samples
    seen = {row: np.asarray(matrices[row][:, columns].sum(axis=1)).ravel() > 0 for row, columns in views.items()}
    alone = set(apart(shared(seen, features), tuple(views)))
    for here in sorted(alone):
        for there in sorted(set(views) - alone):
            for one, other in ((here, there), (there, here)):
                open_ = np.flatnonzero(usable[one])
                gain = (features.areas * (seen[other] & ~seen[one])) @ matrices[one][:, open_]
                for column in open_[np.argsort(-gain, kind="stable")[:_TRIED]]:
                    more = seen[one] | (np.asarray(matrices[one][:, [column]].todense()).ravel() > 0)
                    if not left_free(more, seen[other], features):
                        return one, int(column)
    return None
