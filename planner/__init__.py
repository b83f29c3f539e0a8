"""Mathematics of view planning: geometry, viewpoints, measurability, set cover, tour, path, timing.

No module opens a file or a port or uses a physics or ray engine; the protocols of `planner.ports` give access to them.
Lengths are metres, angles radians, times seconds.
"""
