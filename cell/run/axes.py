"""Joint vectors in files: the arm's six angles where they always were, those of external axes in arrays beside them.

`via_q` (N, 6) and `via_e` (N, n) are one `q` (N, 6 + n) in code. A plan without external axes has no array of them.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.ports import ARM_AXES
from planner.values import Floats

EXTERNAL: Mapping[str, str] = {
    "via_q": "via_e",
    "q": "e",
    "qd": "ed",
    "qdd": "edd",
    "q_commanded": "e_commanded",
    "q_reported": "e_reported",
}
"""Name of the array of external axes, by that of the arm's."""


def apart(**arrays: Floats) -> dict[str, Floats]:
    """Arrays (..., axes) as they stand in a file."""
    found = {}
    for name, values in arrays.items():
        found[name] = values[..., :ARM_AXES]
        if values.shape[-1] > ARM_AXES:
            found[EXTERNAL[name]] = values[..., ARM_AXES:]
    return found


def joined(stored: Mapping[str, NDArray[Any]], name: str) -> Floats:
    """(..., axes) of the arrays of a file."""
    external = stored.get(EXTERNAL[name])
    return stored[name] if external is None else np.concatenate([stored[name], external], axis=-1)
