"""Where the points of an execution come from: simulated, files, a command, or a plug-in's source (`sources`)."""

SIMULATED = "simulated"
"""The source of the virtual scanner."""
