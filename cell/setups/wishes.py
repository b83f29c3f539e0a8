"""What is asked of all set-ups together, and the one cover problem of their columns that asks it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_array, hstack

from cell.errors import UsageError
from cell.plan import steps
from cell.plan.pose_uncertainty import pose_error
from cell.plan.region_goals import RegionGoals
from cell.plan.request import Request
from cell.plan.steps import PlanSession
from cell.scene.model import Scene, with_rest
from cell.setups.measured import Setup
from cell.setups.options import SetupOptions, named
from planner.cover import CoverProblem
from planner.cover.robust import DEMAND, loads
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.measurability.pose_ensemble import ProbabilityLayer
from planner.values import Bools, Floats


def require_named(options: SetupOptions, tried: Sequence[Setup | str]) -> None:
    """Refuse candidates that there are not, and pinned ones that cannot be taken.

    Args:
        options: they name them.
        tried: the set-ups offered, or why one cannot be.

    Raises:
        UsageError: naming the first.
    """
    for setup, number in (*options.pins, *options.bans):
        name, found = named((setup, number)), tried[setup] if setup < len(tried) else ""
        if setup >= len(tried):
            raise UsageError(f"candidate {name}: there are {len(tried)} set-ups offered, 0 to {len(tried) - 1}")
        if not isinstance(found, Setup):
            raise UsageError(f"candidate {name}: set-up {setup} cannot be ({found}); name another")
        if number >= len(reachable := found.measured.reached.reachable):
            raise UsageError(f"candidate {name}: set-up {setup} has candidates 0 to {len(reachable) - 1}")
        if (setup, number) in options.pins and not reachable[number]:
            raise UsageError(f"candidate {name} is pinned, and the arm does not reach it; pin another")


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """The wishes with what is known of the set-ups.

    Attributes:
        request: the scene's, as of one plan.
        own: beyond it.
        seconds: of each set-up by its number, (V,) what its candidates cost; empty where views are counted.
        layers: of each, probabilities of the entries of its matrix; empty where poses count as exact.
    """

    request: Request
    own: SetupOptions
    seconds: Mapping[int, Floats] = field(default_factory=dict)
    layers: Mapping[int, ProbabilityLayer] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene, own: SetupOptions) -> "Asked":
        """What a scene asks.

        Raises:
            UsageError: if set-ups are to have a cost, and regions wishes of their own.
        """
        goals = RegionGoals.of(with_rest(scene.region), scene.plan)
        if own.setup_s is not None and goals is not None and not goals.plain:
            raise UsageError(
                "seconds for each set-up go without regions that have a coverage, views or weight of their own; leave "
                "out one of them"
            )
        return cls(Request(scene.plan, goals=goals), own)

    def about(self, session: PlanSession, setups: Mapping[int, Setup]) -> "Asked":
        """With what the wishes need to know of the set-ups: seconds of views, probabilities under pose errors."""
        seconds, layers = dict[int, Floats](), dict[int, ProbabilityLayer]()
        for row, setup in setups.items():
            job = replace(setup.job, scene=setup.job.scene.model_copy(update={"plan": self.request.plan}))
            told = steps.ask(session, job, setup.cell, setup.measured, setup.prediction).request
            seconds |= {} if told.costs is None else {row: told.costs}
            layers |= {} if told.layer is None else {row: told.layer}
        return replace(self, seconds=seconds, layers=layers)

    @property
    def promises(self) -> bool:
        """Whether a coverage is kept on held-out samples."""
        return self.request.promises and pose_error(self.request.plan).is_exact

    @property
    def once(self) -> bool:
        """Whether a sample is measured where one view does: no number of views is asked for, and no probability."""
        goals = self.request.goals
        several = self.request.plan.multiplicity > 1 or (goals is not None and (goals.views > 1).any())
        return not several and pose_error(self.request.plan).is_exact

    @property
    def plain(self) -> bool:
        """Whether views may be moved and exchanged: their number counts, and none is named by the user."""
        of_user = self.own.pins or self.own.bans
        one = self.request.goals is None and self.request.plan.cost == "views" and self.request.brief
        return one and not of_user and self.request.exchangeable and pose_error(self.request.plan).is_exact

    def problem(self, M: Mapping[int, Measurability], usable: Mapping[int, Bools]) -> CoverProblem:
        """The columns of all set-ups side by side, those of each a group, and all wishes but the coverage.

        Args:
            M: of each set-up by its number, over the same rows.
            usable: for each (V,) columns that may be chosen.
        """
        request, numbers = self.request, list(M)
        features = M[numbers[0]].samples
        first = dict(zip(numbers, np.cumsum([0, *(M[row].n_viewpoints for row in numbers[:-1])]), strict=True))
        allowed, demand = np.concatenate([usable[row] for row in numbers]), request.plan.multiplicity
        if self.layers:
            matrix, demand = hstack([self.brought(row, M[row]) for row in numbers], format="csc"), DEMAND
            # a row that cannot be promised is asked for nothing
            matrix.data = matrix.data * (matrix @ allowed.astype(np.int64) >= DEMAND)[matrix.indices]
        else:
            matrix = hstack([M[row].matrix() for row in numbers], format="csc")
        wish = CoverProblem(
            matrix, features.areas, allowed, max_views=request.plan.max_views, demand=demand,
            costs=np.concatenate([self.seconds[row] for row in numbers]) if self.seconds else None,
            pinned=[int(first[row]) + column for row, column in self.own.pins],
            group=np.repeat(np.arange(len(numbers)), [M[row].n_viewpoints for row in numbers]),
            overlap=request.overlap,
        )  # fmt: skip
        if request.goals is None:
            return wish
        asked = request.goals.applied(wish, features)
        return replace(asked, demand=DEMAND) if self.layers else asked

    def shares(self, samples: SurfaceSamples, seen: Bools, can: Bools) -> Floats:
        """(P,) what is seen of what can be measured of held-out samples, of each part of them."""
        if self.request.goals is None:
            return np.array([seen.sum() / max(can.sum(), 1)])  # they stand for equal areas
        return self.request.goals.shares_of(samples, seen, can)

    def brought(self, row: int, M: Measurability) -> csr_array:
        """(S, V) what the views of a set-up bring to each row: 1, or their part of a promise."""
        if not self.layers:
            return csr_array(M.matrix().astype(np.int64))
        layer = self.layers[row].within(M)
        return csr_array(loads(layer, self.request.plan.alpha, (len(M.samples), M.n_viewpoints)))
