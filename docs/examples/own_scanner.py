"""Plan and scan with a scanner of your own: the plug-in range_finder.py in the folder of this script."""

import sys
from pathlib import Path

from cell.api import plan, replay, scan

# A package declares its entry point in pyproject.toml (docs/internals/plug_ins.md), and pip writes these two files.
info = Path("range_finder-1.0.dist-info")
info.mkdir(exist_ok=True)
(info / "METADATA").write_text("Metadata-Version: 2.1\nName: range-finder\nVersion: 1.0\n")
(info / "entry_points.txt").write_text("[cell.scanners]\nrange-finder = range_finder:RangeFinder\n")
sys.path.append(str(Path.cwd()))

Path("cell.toml").write_text('[scanner]\ntype = "range-finder"\nhalf_angle_deg = 20.0\nrange_mm = [50.0, 250.0]\n')
options = {"place": (1100, 300, 100), "faces": 60, "candidates": "optimal-scanning-zone"}
run = plan("mug", scene="cell.toml", effort="low", out="own", **options)
print(run)
execution = scan(run)
print(execution)
print(f"{len(execution.points)} points, planned coverage {run.coverage.visible:.1%}")
print(replay(run, picture="example_own_scanner.png", execution="latest"))
