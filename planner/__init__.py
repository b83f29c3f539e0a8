"""Mathematics of view planning: geometry, kinematics, viewpoints, measurability, set cover, tour, path, time.

This package opens no file or port and uses no physics or ray engine: it gets such information through the protocols of
`planner.ports`. Lengths are in metres, angles in radians, times in seconds.
"""
