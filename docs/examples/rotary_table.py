"""Plan a part with and without a rotary table, and compare views, coverage and time."""

from cell.api import plan, replay

OPTIONS = {"place": (1200, 300, 0), "faces": 60, "candidates": "optimal-scanning-zone", "effort": "low"}

fixed = plan("mug", out="fixed", **OPTIONS)
turned = plan("mug", table=True, out="turned", **OPTIONS)
for name, run in (("fixed part", fixed), ("rotary table", turned)):
    print(f"{name}: {len(run.q)} views, {run.coverage.visible:.1%} of the surface, {run.motion.duration:.1f} s")
print("angles of the table [rad]:", turned.q[:, 6].round(2))  # after the six axes of the arm
print(replay(turned, picture="example_rotary_table.png", camera=(-60, 25)))
