"""The plan's report: the page that a person reads, made from the summary in report.json. It holds no clock value."""

from collections.abc import Mapping
from typing import Any


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
        f"| scanner | {settings['scanner']}, standoff {_list(settings['standoffs_mm'])} mm, "
        f"baseline {settings['baseline_mm']:g} mm, "
        f"range {settings['range_mm'][0]:g} to {settings['range_mm'][1]:g} mm |",
        f"| field of view, grazing limits | {_times(settings['fov_deg'])} deg, "
        f"source {settings['grazing_max_deg']:g} deg, sensor {settings['sensor_grazing_max_deg']:g} deg |",
        f"| candidates | {settings['candidates']}, {sum(summary['verdicts'].values()):,} |",
        f"| matrix | {settings['fill']}, {summary['n_features']:,} surface samples |",
        f"| selection | {summary['solver']}, {summary['n_views']} views, lower bound {summary['lower_bound']}, "
        f"gap {_percent(summary['gap'])} |",
        f"| motion | {motion['duration_s']:.2f} s home to home, {motion['via_points']} points, speed "
        f"{_percent(motion['speed_fraction'])} |",
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
    lines += ["", "![Coverage over number of views](cover.png)", "", "## Motion", ""]
    if motion["minimum_clearance_mm"] is not None:
        lines += [f"Nearest approach: {motion['minimum_clearance_mm']:.1f} mm, {motion['between']}.", ""]
    lines += [
        f"In task-space order (Christofides) the same views would take {motion['baseline_duration_s']:.2f} s.",
        "",
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


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %"


def _list(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _times(values: list[float]) -> str:
    return " x ".join(f"{value:g}" for value in values)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
