"""`cell replay`: a run in the viewer, as frames or as one picture."""
