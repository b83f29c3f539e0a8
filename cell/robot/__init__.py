"""The robot: its model file or another one in the same form, limits, kinematics, dynamics."""
