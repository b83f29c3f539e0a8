"""Measure a part without a model: views in batches, each planned on the points of those before."""

import matplotlib.pyplot as plt

from cell.api import explore

explored = explore("mug", place=(1100, 400, 100), max_views=6, resolution=1, effort="low", out="explored")
print(explored)
print("stop reason:", explored.file.stop_reason)
for each in explored.file.uncovered:
    print(f"uncovered {each.area_mm2:.0f} mm2: {each.cause}")
mesh = explored.mesh  # metres; explored.model is its file
axes = plt.figure(figsize=(6, 5)).add_subplot(projection="3d")
axes.plot_trisurf(*(1000 * mesh.vertices.T), triangles=mesh.faces, color="tab:blue")
axes.set(title="measured surface, mm", aspect="equal")
plt.savefig("example_explore_part.png")
