"""The tour search over many views ends with real tours, and inspects more edges for more views."""

import numpy as np
import pytest

from planner.ports import JointLimits
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import order_views
from planner.tour.roadmap import Edge, Roadmap
from planner.tour.tour_search import _VERY_MANY, MotionBudget, TourSearch
from planner.tour.visits import Visits

LIMITS = JointLimits(np.full(6, -3.0), np.full(6, 3.0), np.full(6, 2.0), np.full(6, 4.0))


class Open:
    """A checker without obstacles."""

    clearance = 0.01

    def free(self, q: np.ndarray) -> np.ndarray:
        return np.ones(len(q), dtype=bool)

    def travel(self, q_from: np.ndarray, q_to: np.ndarray) -> np.ndarray:
        return 0.01 * np.abs(np.asarray(q_to) - q_from).sum(axis=-1)


class AlwaysNew(TourSearch):
    """A search that reports new collisions near every tour whose edges are free."""

    def inspect_around(self, nodes: list[int]) -> tuple[list[int], bool]:
        self.roadmap.inspect(self.edges(nodes))
        return nodes, False


def search_of(kind: type[TourSearch], views: int) -> TourSearch:
    """Return a search over views with two configurations each."""
    rng = np.random.default_rng(0)
    q = np.round(np.degrees(rng.uniform(-1, 1, (views, 2, 6))), 4)
    visits = Visits([np.radians(own) for own in q], np.zeros(6), np.tile(np.eye(4), (views, 1, 1)))
    roadmap = Roadmap(visits, Open(), LIMITS, 0, 1000, 10_000)
    return kind(roadmap, visits, LIMITS, 0, MotionBudget(), order_views, None)


@pytest.mark.slow
def test_a_real_tour_of_very_many_views_ends_the_search() -> None:
    """The search of very many views ends with a feasible tour, although some edges are always uninspected."""
    search = search_of(AlwaysNew, _VERY_MANY + 1)
    nodes = search.run()
    assert sorted(search.view_of(node) for node in nodes[1:-1]) == list(range(_VERY_MANY + 1))
    assert all(search.roadmap.path(*edge) is not None for edge in search.edges(nodes))
    assert search.rounds <= 5


@pytest.mark.parametrize("views", [3 * gtsp.MANY_CLUSTERS, 5 * gtsp.MANY_CLUSTERS])
def test_more_edges_are_inspected_for_more_views(views: int) -> None:
    """Above a hundred views more edges are inspected per ordering, so the number of orderings does not grow."""
    search = search_of(TourSearch, views)
    edges: list[Edge] = search.through([np.array([0]), *map(search.roadmap.nodes_of, range(views)), np.array([0])])[1]
    assert len(edges) == MotionBudget().neighbours * (5 if views > _VERY_MANY else 1)
