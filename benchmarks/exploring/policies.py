"""All policies of the laboratory, and the settings over which their rivals were tuned."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from benchmarks.exploring.density import SETTINGS, density_frontier
from benchmarks.exploring.lab import Policy
from benchmarks.exploring.ours import stepwise
from benchmarks.exploring.rivals import random, uniform, volumetric
from benchmarks.exploring.view_spaces import VIEW_SPACES

RIVALS: Mapping[str, tuple[Callable[[str], Policy], tuple[str, ...]]] = MappingProxyType(
    {
        "uniform": (uniform, tuple(VIEW_SPACES)),
        "random": (random, tuple(VIEW_SPACES)),
        "volumetric": (volumetric, tuple(VIEW_SPACES)),
        "density": (density_frontier, SETTINGS),
    }
)
"""Name -> the policy of a setting, and the settings that it is tuned over, four each."""

TUNED = MappingProxyType(
    {"uniform": "sphere, middle", "random": "sphere, middle", "volumetric": "sphere, middle", "density": "12, most"}
)
"""The setting of each rival: the largest mean of true coverage after 5, 10 and 15 views on mug and bunny, seed 0.

`SCAN_CELL_TUNE=1 python -m benchmarks explore` gives the rows.
"""

POLICIES: Mapping[str, Policy] = MappingProxyType(
    {"stepwise": stepwise, **{name: make(TUNED[name]) for name, (make, _) in RIVALS.items()}}
)
