"""The compiled test which sets contain others, for dominated columns and dominated rows alike."""

from typing import Any

import numpy as np

from planner.compiled import compiled


@compiled
def dominated(
    bits: Any, sizes: Any, rarest: Any, of_start: Any, of_member: Any, price: Any, group: Any, need: Any,
    larger_goes: bool,
) -> Any:  # fmt: skip
    """Which sets others make superfluous.

    Of two sets of which one contains the other, one may go where it costs the user nothing: a column that is contained
    where as many columns as it needs contain it, a row that contains another. Of equal ones the later goes.

    Args:
        bits: (N, words) the sets, a bit for each member.
        sizes: (N,) members of each.
        rarest: (N,) the member of each that is in the fewest sets: only sets that share it can contain the set.
        of_start: with `of_member` the sets of each member.
        of_member: see there.
        price: (N,) what contains may not have a larger one than what is contained.
        group: (N,) nor be of another group, where its own is not -1.
        need: (N,) how many must contain a set; looked at unless `larger_goes`.
        larger_goes: the set that contains goes, not the one that is contained.

    Returns:
        (N,) bool.
    """
    gone = np.zeros(len(sizes), dtype=np.bool_)
    for j in range(len(sizes)):
        if sizes[j] == 0 or (larger_goes and gone[j]):
            continue
        found = 0
        for at in range(of_start[rarest[j]], of_start[rarest[j] + 1]):
            other = of_member[at]
            if other == j or sizes[other] < sizes[j] or price[other] > price[j]:
                continue
            if sizes[other] == sizes[j] and price[other] == price[j] and (other > j) != larger_goes:
                continue
            if (larger_goes and gone[other]) or (group[other] >= 0 and group[other] != group[j]):
                continue
            inside = True
            for word in range(bits.shape[1]):
                if bits[j, word] & ~bits[other, word]:
                    inside = False
                    break
            if not inside:
                continue
            if larger_goes:
                gone[other] = True
                continue
            found += 1
            if found >= need[j]:
                gone[j] = True
                break
    return gone
