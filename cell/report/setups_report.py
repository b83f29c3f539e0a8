"""Report of several set-ups for people: report.md, and the rows of a terminal."""

from collections.abc import Sequence

import numpy as np

from cell.formatting import comma_list, percent
from cell.report.plan_report import curve_section
from cell.runs.schema import CommonSurface, SetupsFile, UncoveredShares
from planner.cover.grouped import GroupedCover
from planner.values import Floats

_CAUSES = {
    "not_selected": "candidates measure it, and less was requested (--coverage)",
    "in_contact": "a support touches it in every set-up",
    "out_of_reach": "the search found no reachable pose that sees it (use another placement, or [[setup]] tables)",
    "other_poses": "no candidate measures it, though other poses would (--candidates grown, --faces)",
    "out_of_sight": "the search found no pose that sees it past the part and its surroundings",
}


def status(cover: GroupedCover, offered: int, requested: Floats) -> str:
    """Describe the bounds on both numbers, for these candidates and samples.

    Args:
        cover: of all set-ups.
        offered: number of set-up candidates.
        requested: (P,) share of the coverable samples of each group of regions.
    """
    setups, setups_bound, views, views_bound = len(cover.views), cover.group_bound, cover.n_views, cover.view_bound
    count = "1 set-up" if setups == 1 else f"{setups} set-ups"
    fewest = (
        f"proven fewest of {offered} set-up candidates"
        if setups <= setups_bound
        else f"{count}, at least {setups_bound} of {offered} candidates are needed"
    )
    if not cover.is_feasible:
        fewest = f"{setups} of {offered} set-up candidates, too few for the request"
    if cover.upper_area is not None:
        points = 100 * (cover.upper_area - cover.covered_area) / max(cover.upper_area, 1e-300)
        if points <= 0:
            return f"{fewest}; proven maximum coverage for {views} views of the candidates in {count}"
        return f"{fewest}; {views} views in {count} cannot exceed this by more than {max(points, 0.01):.2f} %"
    if cover.cost_and_bound is not None:
        paid, least = cover.cost_and_bound
        in_all = "with the costs of set-ups" if cover.has_group_costs else f"in {count}"
        return f"{fewest}; costs at most {100 * (paid - least) / least:.3g} % more than the cheapest views {in_all}"
    raised = not np.array_equal(cover.targets, requested)
    at = f", at {comma_list(np.round(100 * cover.targets, 2))} % of the samples for the request" if raised else ""
    if views <= views_bound:
        return f"{fewest}; optimal for the candidates in {count} (bound {views_bound}){at}"
    more = views - views_bound
    return f"{fewest}; at most {more} {'view' if more == 1 else 'views'} more than the fewest in {count}{at}"


def rows(file: SetupsFile) -> list[tuple[str, str]]:
    """Return names and values for a terminal."""
    coverage = file.coverage
    result = [
        ("set-ups", f"{len(file.selected)}  ({file.status})"),
        ("views", f"{file.views} in all, lower bound {file.views_bound}"),
        (
            "visible coverage",
            f"{percent(coverage.visible)} of the surface, {percent(coverage.visible_of_coverable)} of the surface that "
            "the set-up candidates can measure",
        ),
    ]
    if (first := file.alternative) is not None:
        less = f"{first.views} suffice in {first.setups} set-ups (--cost time --setup-seconds S weighs the two)"
        result.append(("fewer views", less))
    if file.satisfied_share is not None:
        result.append(("targets met", f"on {percent(file.satisfied_share)} of the coverable surface"))
    if file.seconds is not None:
        result.append(("cost", f"{file.seconds:.1f} s, lower bound {file.seconds_bound:.1f} s"))
    result += [
        (
            f"region {each.name}",
            f"{percent(each.visible)} of it, {percent(each.visible_of_coverable)} of its coverable surface"
            f" (requested {percent(each.target)})",
        )
        for each in file.regions
    ]
    result += [
        (
            setup.folder,
            f"{file.candidates[setup.candidate].name}: {setup.views} views, marginal coverage "
            f"{percent(setup.marginal_coverage)}",
        )
        for setup in file.selected
    ]
    if file.uncovered is not None:
        result += [
            ("uncovered", f"{percent(share)}: {_CAUSES[name]}")
            for name, share in _reasons(file.uncovered)
            if share >= 5e-5
        ]
    best = max(each.coverable for each in file.candidates)
    return [*result, ("best single set-up", f"its candidates measure {percent(best)} of the surface")]


def page(file: SetupsFile) -> str:
    """Return report.md."""
    lines = [f"# Set-ups of {file.part}", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in rows(file)]
    lines += [
        "",
        "## Set-up candidates\n",
        "| | pose | x, y, z mm | A, B, C deg | reachable | coverable | in contact | |",
    ]
    lines += ["|---|---|---|---|---|---|---|---|"]
    for row, each in enumerate(file.candidates):
        use = next(
            (f"[{setup.folder}]({setup.folder}/report.md)" for setup in file.selected if setup.candidate == row), ""
        )
        lines.append(
            f"| {row} | {each.name} | {comma_list(each.placement_mm)} | {comma_list(each.placement_abc_deg)} "
            f"| {each.reachable} | {percent(each.coverable)} | {percent(each.in_contact)} | {each.cause or use} |"
        )
    curve = ["", *curve_section(file.curve)] if file.curve else []
    return "\n".join([*lines, *shared_surface(file.common_surface), *curve, ""])


def shared_surface(pairs: Sequence[CommonSurface]) -> list[str]:
    """Return the section on the surface that pairs of set-ups share; empty without pairs."""
    if not pairs:
        return []
    head = ["", "## Shared surface", "", "| set-ups | of the surface | free motions |", "|---|---|---|"]
    rows = ((*pair.setups, percent(pair.share), "; ".join(pair.free_motions)) for pair in pairs)
    return head + [f"| {one} and {other} | {share} | {free} |" for one, other, share, free in rows]


def _reasons(shares: UncoveredShares) -> list[tuple[str, float]]:
    """Return names and shares of the causes, the largest first."""
    return sorted(((name, getattr(shares, name)) for name in _CAUSES), key=lambda each: -each[1])
