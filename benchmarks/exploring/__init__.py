"""A laboratory for the choice of the next view: no robot, an equal first view, rivals behind one signature."""
