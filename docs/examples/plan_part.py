"""Plan a built-in part and look at the result: numbers, causes of uncovered surface, page and picture."""

from cell.api import plan, replay, view, why

run = plan("mug", place=(1100, 300, 100), faces=60, candidates="optimal-scanning-zone", effort="low", out="mug")
print(run)  # a table with a picture in a notebook
print(f"measured {run.coverage.visible:.1%} of the surface, coverable {run.coverage.coverable:.1%}")
for each in run.views:
    x, y, z = 1000 * each.T_base_scanner[:3, 3]
    print(f"view {each.number}: scanner at {x:.0f}, {y:.0f}, {z:.0f} mm, adds {each.marginal_coverage:.1%}")
for group in why(run).summary.groups[:3]:
    print(f"uncovered {group.share:.1%}: {group.title}")
print("page for the browser:", view(run))
print(replay(run, picture="example_plan_part.png"))
