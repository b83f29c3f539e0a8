"""What two set-ups both measure, and whether it holds their scans together: freedom decides, not area."""

from collections.abc import Mapping
from itertools import combinations

from cell.reconstruction.freedom import FreeMotion, of_surface
from cell.reconstruction.rigid import told
from cell.run.setups_json import SharedSurface
from planner.surface.sample import SurfaceSamples
from planner.values import Bools


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
            free=(told(free),) if (free := left_free(seen[one], seen[other], samples)) else (),
        )
        for one, other in combinations(sorted(seen), 2)
    )


def left_free(one: Bools, other: Bools, samples: SurfaceSamples) -> tuple[FreeMotion, ...]:
    """Motions of one set-up against another that the surface which both measure does not show.

    None where all that they measure shows no more: a ball that both see turns as it likes, and nothing is lost by it.
    """
    both, any_ = one & other, one | other
    free = of_surface(samples.points[both], samples.normals[both])
    return free if len(free) > len(of_surface(samples.points[any_], samples.normals[any_])) else ()


def apart(pairs: tuple[SharedSurface, ...], numbers: tuple[int, ...]) -> tuple[int, ...]:
    """Set-ups that no chain of pairs which hold together joins to the first."""
    joined = {numbers[0]} if numbers else set()
    for _ in numbers:
        joined |= {each for pair in pairs if not pair.free and joined & set(pair.setups) for each in pair.setups}
    return tuple(number for number in numbers if number not in joined)
