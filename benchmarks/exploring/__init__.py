"""Laboratory for the choice of the next view: no robot, an equal first view, one signature for all rivals."""
