"""What is said of several set-ups: the page, and the rows of a terminal."""

from collections.abc import Sequence

import numpy as np

from cell.plan.request_report import coverage_over_views
from cell.runs.schema import PlannedOpen, SetupsFile, SharedSurface
from cell.words import listed, percent
from planner.cover.grouped import GroupedCover
from planner.values import Floats

_WHY = {
    "not_asked": "candidates measure it, and less was asked for (--coverage)",
    "in_contact": "a support touches it in every set-up",
    "out_of_reach": "the arm takes up no pose that sees it (another place, or [[setup]] poses of your own)",
    "other_poses": "no candidate measures it, though other poses would (--candidates grown, --faces)",
    "out_of_sight": "no pose sees it past the part and what stands about it",
}


def status(found: GroupedCover, offered: int, asked: Floats) -> str:
    """What is proven of both numbers, for these candidates and samples.

    Args:
        found: the cover.
        offered: set-ups that were looked at.
        asked: (P,) share of what can be measured of each part of the samples that was asked for.
    """
    setups, setups_bound, views, views_bound = len(found.views), found.group_bound, found.n_views, found.view_bound
    fewest = (
        f"proven fewest of the {offered} set-ups offered"
        if setups <= setups_bound
        else f"{setups} set-ups, not fewer than {setups_bound} of the {offered} offered"
    )
    if not found.is_feasible:
        fewest = f"{setups} of the {offered} set-ups offered, too few for what was asked"
    if found.upper_area is not None:
        points = 100 * (found.upper_area - found.covered_area) / max(found.upper_area, 1e-300)
        if points <= 0:
            return f"{fewest}; proven most that so many views measure in so many"
        return f"{fewest}; so many views measure at most {max(points, 0.01):.2f} % more in so many"
    if found.price is not None:
        paid, least = found.price
        in_all = "with what set-ups cost" if found.has_group_costs else "in so many"
        return f"{fewest}; costs at most {100 * (paid - least) / least:.3g} % more than the cheapest views {in_all}"
    raised = not np.array_equal(found.targets, asked)
    at = f", at {listed(np.round(100 * found.targets, 2))} % of the samples for what was asked" if raised else ""
    if views <= views_bound:
        return f"{fewest}; proven fewest views in so many{at}"
    more = views - views_bound
    return f"{fewest}; at most {more} {'view' if more == 1 else 'views'} more than the fewest in so many{at}"


def rows(file: SetupsFile) -> list[tuple[str, str]]:
    """Names and values for a terminal."""
    coverage = file.coverage
    found = [
        ("set-ups", f"{len(file.chosen)}  ({file.status})"),
        ("views", f"{file.views} in all, not fewer than {file.views_bound}"),
        (
            "visible coverage",
            f"{percent(coverage.visible)} of the surface, {percent(coverage.visible_of_coverable)} of what the "
            "set-ups offered can measure",
        ),
    ]
    if (first := file.views_first) is not None:
        told = f"{first.views} would do in {first.setups} set-ups (--cost time --setup-seconds S weighs the two)"
        found.append(("fewer views", told))
    if file.kept is not None:
        found.append(("as asked", f"{percent(file.kept)} of what can be, from so many views or with that probability"))
    if file.seconds is not None:
        found.append(("cost", f"{file.seconds:.1f} s, not less than {file.seconds_bound:.1f}"))
    found += [
        (
            f"region {each.name}",
            f"{percent(each.visible)} of it, {percent(each.visible_of_coverable)} of what can be measured"
            f" (asked {percent(each.asked)})",
        )
        for each in file.regions
    ]
    found += [
        (setup.folder, f"{file.offered[setup.offered].name}: {setup.views} views, adds {percent(setup.adds)}")
        for setup in file.chosen
    ]
    if file.open is not None:
        found += [("open", f"{percent(share)}: {_WHY[name]}") for name, share in _reasons(file.open) if share >= 5e-5]
    best = max(each.coverable for each in file.offered)
    return [*found, ("best single set-up", f"{percent(best)} of the surface can be measured in it")]


def page(file: SetupsFile) -> str:
    """report.md of the whole."""
    lines = [f"# Set-ups of {file.part}", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in rows(file)]
    lines += ["", "## Set-ups offered", "", "| | pose | x, y, z mm | A, B, C deg | reachable | coverable | touches | |"]
    lines += ["|---|---|---|---|---|---|---|---|"]
    for row, each in enumerate(file.offered):
        use = next(
            (f"[{chosen.folder}]({chosen.folder}/report.md)" for chosen in file.chosen if chosen.offered == row), ""
        )
        lines.append(
            f"| {row} | {each.name} | {listed(each.placement_mm)} | {listed(each.placement_abc_deg)} | {each.reachable}"
            f" | {percent(each.coverable)} | {percent(each.in_contact)} | {each.left_out or use} |"
        )
    curve = ["", *coverage_over_views(file.curve)] if file.curve else []
    return "\n".join([*lines, *shared_surface(file.shared), *curve, ""])


def shared_surface(pairs: Sequence[SharedSurface]) -> list[str]:
    """The section of what set-ups share, of the plans' report and of the scans'; nothing where there is none."""
    if not pairs:
        return []
    head = ["", "## What set-ups share", "", "| set-ups | of the surface | leaves free |", "|---|---|---|"]
    named = ((*pair.setups, percent(pair.share), "; ".join(pair.free)) for pair in pairs)
    return head + [f"| {one} and {other} | {share} | {free} |" for one, other, share, free in named]


def _reasons(found: PlannedOpen) -> list[tuple[str, float]]:
    """Names and shares, the largest first."""
    return sorted(((name, getattr(found, name)) for name in _WHY), key=lambda each: -each[1])
