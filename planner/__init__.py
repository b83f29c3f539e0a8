"""The mathematics of view planning: surface, viewpoints, measurability, set cover, order, path, time.

Nothing here opens a file or a port or knows a physics or ray engine. What the planner cannot know it asks through the
protocols of `planner.ports`. Lengths are metres, angles radians, times seconds.
"""
