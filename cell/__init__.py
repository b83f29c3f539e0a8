"""The robot cell: scene, MuJoCo, Embree, scanners, run folders and the command line (the composition root).

Python programs import `cell.api`.
"""
