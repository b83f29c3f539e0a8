"""Regions in words: a line each for the terminal, a table for the page."""

import html

from cell.runs.schema import RegionResult, Report
from cell.words import percent


def rows(report: Report) -> list[tuple[str, str]]:
    """(name, sentence) for each region; none for a part without."""
    return [(f"region {each.name}", _sentence(each)) for each in report.regions or ()]


def page(report: Report) -> list[str]:
    """The report's section; no lines for a part without regions."""
    if not report.regions:
        return []
    counted = sum(each.area_mm2 for each in report.regions) / report.part.area_mm2
    lines = [
        "## Regions",
        "",
        f"Shares of the surface in this report are of the {percent(counted)} of the part's surface that the regions "
        "ask for.",
        "",
        "| region | mm² | asked of what is coverable | coverable | measured | of what is coverable | limits |",
        "|---|---|---|---|---|---|---|",
    ]
    for each in report.regions:
        views = f", from {each.views} views" if each.views > 1 else ""
        lines.append(
            f"| {html.escape(each.name)} | {each.area_mm2:,.0f} | {percent(each.asked)}{views} | "
            f"{percent(each.coverable)} | {percent(each.visible)}{_enough(each)} | "
            f"{percent(each.visible_of_coverable)} | {_limits(each) or 'none'} |"
        )
    told = [f"- {html.escape(each.name)}: {html.escape(each.reason)}." for each in report.regions if each.reason]
    return [*lines, "", *told, *([""] if told else [])]


def missed(report: Report) -> list[str]:
    """A sentence for each coverage below 1 that is not kept on the held-out samples: of a region, or of several."""
    regions = report.regions or ()
    groups = [[each] for each in regions if not each.shared] + [[each for each in regions if each.shared]]
    found = []
    for group in groups:
        can = sum(each.coverable * each.area_mm2 * each.weight for each in group)
        has = sum(each.visible * each.area_mm2 * each.weight for each in group)
        if can > 0 and group[0].asked < 1 and has < group[0].asked * can:
            names = " and ".join(f"'{each.name}'" for each in group)
            found.append(
                f"of what can be measured of {names} the plan measures {percent(has / can)}, less than the "
                f"{100 * group[0].asked:g} % asked for; see cell why"
            )
        closed = [each for each in group if each.coverable == 0]
        found += [f"nothing of the region '{each.name}' can be measured: {each.reason}" for each in closed]
    return found


def _sentence(region: RegionResult) -> str:
    limits = _limits(region)
    return (
        f"{percent(region.visible)} of {region.area_mm2:,.0f} mm² measured{_enough(region)}, "
        f"{percent(region.visible_of_coverable)} of what reachable candidates can measure"
        + (f"; {limits}" if limits else "")
        + (f"; {region.reason}" if region.reason else "")
    )


def _enough(region: RegionResult) -> str:
    """What is measured from as many views as were asked for, where that is more than one."""
    return f", {percent(region.from_enough_views)} from {region.views} views" if region.views > 1 else ""


def _limits(region: RegionResult) -> str:
    limits = [] if region.max_spacing_mm is None else [f"points at most {region.max_spacing_mm:g} mm apart"]
    limits += [] if region.max_sigma_mm is None else [f"sigma at most {region.max_sigma_mm:g} mm"]
    return ", ".join(limits)
