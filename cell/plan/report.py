"""The plan's report: the page that a person reads, made from the summary in report.json. It holds no clock value."""

from collections.abc import Mapping
from typing import Any

from cell.plan import told
from cell.plan.clearances import tightest_sentence

_PART = {
    "hull": "its convex hull",
    "decomposed": "convex pieces that enclose it",
    "exact": "its triangles",
}


def markdown(summary: Mapping[str, Any]) -> str:
    """The report page; reads on its own, with its pictures beside it.

    Args:
        summary: the object that `report.json` holds.
    """
    part, coverage, motion = summary["part"], summary["coverage"], summary["motion"]
    settings = summary["settings"]
    lines = [
        f"# View plan of {part['name']}",
        "",
        f"{summary['n_views']} views measure {_percent(coverage['visible'])} of the surface, "
        f"{_percent(coverage['visible_of_coverable'])} of what the reachable candidates can measure "
        f"({_percent(coverage['coverable'])}). {_sentence(summary['status'])}",
        "",
        "![The part and its views](views.png)",
        "",
        "| | |",
        "|---|---|",
        f"| part | {part['name']}: {part['faces']:,} faces, {_times(part['extents_mm'])} mm, "
        f"{part['area_mm2']:,.0f} mm² |",
        f"| planning mesh | {part['planning_faces']:,} faces |",
        f"| placement of its centre in base | {_list(settings['placement_mm'])} mm, "
        f"A B C {_list(settings['placement_abc_deg'])} deg |",
        *_scanner_rows(settings),
        f"| candidates | {settings['candidates']}, {sum(summary['verdicts'].values()):,} |",
        f"| matrix | {settings['fill']}, {summary['n_features']:,} surface samples |",
        f"| selection | {summary['solver']}, {summary['n_views']} views, lower bound {summary['lower_bound']}, "
        f"gap {_percent(summary['gap'])} |",
        f"| motion | {motion['duration_s']:.2f} s home to home, {motion['via_points']} points, speed "
        f"{_percent(motion['speed_fraction'])} |",
        f"| the same stops without a limit of jerk (time-optimal bound) | {_bound(motion)} |",
        *(f"| {name} | {sentence} |" for name, sentence in told.rows(summary)),
        *_arm_and_sigma(summary),
        f"| seed | {settings['seed']} |",
        "",
    ]
    if part["findings"]:
        lines += ["## What the mesh check found", "", *(f"- {finding}" for finding in part["findings"]), ""]
    lines += ["## Reach", "", "| verdict | candidates |", "|---|---|"]
    lines += [f"| {name.replace('_', ' ')} | {count} |" for name, count in summary["verdicts"].items()]
    if summary["blockers"]:
        lines += ["", "Collisions are with: " + ", ".join(f"{k} ({n})" for k, n in summary["blockers"].items()) + "."]
    lines += ["", "![Candidates by verdict](reach.png)", "", "## Views in visiting order", ""]
    lines += [
        "| stop | candidate | adds % of surface | source in base x, y, z mm | A1 .. A6 deg | roll deg "
        "| clearance on the way mm |",
        "|---|---|---|---|---|---|---|",
    ]
    for stop, view in enumerate(summary["views"], start=1):
        clearance = view["clearance_on_the_way_mm"]
        lines.append(
            f"| {stop} | {view['id']} | {100 * view['adds']:.2f} | {_list(view['source_in_base_mm'])} | "
            f"{_list(view['q_deg'])} | {view['roll_deg']:g} | {'' if clearance is None else f'{clearance:.1f}'} |"
        )
    if summary["dropped"]:
        lines += ["", "Dropped, and the cover solved again without them:", ""]
        lines += [f"- candidate {view['id']}: {view['reason']}" for view in summary["dropped"]]
    lines += ["", "![Coverage over number of views](cover.png)", "", *told.page(summary), "## Motion", ""]
    tightest = tightest_sentence(summary["clearance"])
    if tightest:
        lines += [f"Tightest moment: {tightest}; the part is {_PART[summary['clearance']['collision']]}.", ""]
    lines += [
        f"In task-space order (Christofides) the same views would take {motion['baseline_duration_s']:.2f} s.",
        "",
        *_of_sweeps(settings),
        "![Joint motion](motion.png)",
        "",
        "## What the numbers mean",
        "",
        "Visible coverage is the share of 100,000 seeded samples of the reference surface, not those that the "
        "optimiser saw, that at least one view measures: laser and sensor legs free of part, fixtures, post, pedestal "
        "and floor, in the field of view, in range, grazing limits kept. The lower bound is over these candidates and "
        "samples.",
        "",
    ]
    return "\n".join(lines)


def table(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What a terminal shows of the plan: names and values.

    Args:
        summary: the object that `report.json` holds.
    """
    coverage, motion, verdicts = summary["coverage"], summary["motion"], summary["verdicts"]
    clearance, bound = motion["minimum_clearance_mm"], motion["jerk_free_bound_s"]
    fewest = summary["lower_bound"]
    rows = [
        ("views", f"{summary['n_views']}  ({summary['status']})"),
        ("lower bound", f"{'1 view' if fewest == 1 else f'{fewest} views'} for these candidates and samples"),
        (
            "visible coverage",
            f"{_percent(coverage['visible'])} of the surface, {_percent(coverage['visible_of_coverable'])} of what "
            "reachable candidates can measure",
        ),
        *told.rows(summary),
        ("candidates", ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in verdicts.items())),
    ]
    if summary["dropped"]:
        rows.append(("dropped", "; ".join(f"view {view['id']}: {view['reason']}" for view in summary["dropped"])))
    took = (
        f"{motion['duration_s']:.1f} s from home to home through {motion['via_points']} points"
        + (f", {motion['duration_s'] / bound:.3f} x the time-optimal bound without jerk limit" if bound else "")
        + ("" if clearance is None else f"; nearest {clearance:.1f} mm ({motion['between']})")
    )
    return [*rows, ("motion", took)]


def _scanner_rows(settings: Mapping[str, Any]) -> list[str]:
    """The scanner's rows of the table; a plug-in's own keys stand as they are named."""
    row = f"| scanner | {settings.get('sensor') or settings['scanner']}, standoff {_list(settings['standoffs_mm'])} mm"
    if "baseline_mm" in settings:
        row += f", baseline {settings['baseline_mm']:g} mm"
    if "range_mm" in settings:
        row += f", range {settings['range_mm'][0]:g} to {settings['range_mm'][1]:g} mm"
    rows = [row + " |"]
    if {"fov_deg", "grazing_max_deg", "sensor_grazing_max_deg"} <= set(settings):
        rows.append(
            f"| field of view, grazing limits | {_times(settings['fov_deg'])} deg, "
            f"source {settings['grazing_max_deg']:g} deg, sensor {settings['sensor_grazing_max_deg']:g} deg |"
        )
    elif "fan_deg" in settings:
        sweep = f"turned by {settings['sweep_deg']:g} deg" if "sweep_deg" in settings else "straight"
        length = f", {settings['sweep_mm']:g} mm" if "sweep_mm" in settings else ""
        rows.append(
            f"| fan, sweep, grazing limits | {settings['fan_deg']:g} deg, {sweep}{length} in {settings['sweep_poses']} "
            f"poses, source {settings['grazing_max_deg']:g} deg, sensor {settings['sensor_grazing_max_deg']:g} deg |"
        )
    return rows


def _of_sweeps(settings: Mapping[str, Any]) -> list[str]:
    """What there is to know about views that sweep."""
    if "sweep_poses" not in settings:
        return []
    return [
        f"Each view is a sweep of {settings['sweep_poses']} poses, driven as a straight line at constant speed on one "
        f"joint branch, in {settings['sweep_s'][0]:.1f} to {settings['sweep_s'][1]:.1f} s. Its singularities, joint "
        "limits and collisions are looked at between its poses too; the arm's own shadow along it is not judged.",
        "",
    ]


def _arm_and_sigma(summary: Mapping[str, Any]) -> list[str]:
    """Rows for what the arm hides and for the precision of the points, where there is something to say."""
    rows, visible, with_arm = [], summary["coverage"]["visible"], summary["coverage"].get("visible_with_arm")
    if with_arm is not None and with_arm < visible:
        rows.append(f"| visible coverage with each view's own arm in the way | {_percent(with_arm)} |")
    if "sigma" in summary:
        sigma = summary["sigma"]
        rows.append(
            f"| expected standard deviation of a point | median {sigma['median_mm']:.4f} mm, 95 % below "
            f"{sigma['quantile_95_mm']:.4f} mm, limit {sigma['limit_mm']:g} mm |"
        )
    return rows


def _bound(motion: Mapping[str, Any]) -> str:
    """The bound without a limit of jerk, and how far the motion is from it."""
    bound = float(motion["jerk_free_bound_s"])
    return f"{bound:.2f} s" + (f"; the motion takes {motion['duration_s'] / bound:.3f} x as long" if bound else "")


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %"


def _list(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _times(values: list[float]) -> str:
    return " x ".join(f"{value:g}" for value in values)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
