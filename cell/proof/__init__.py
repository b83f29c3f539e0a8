"""What must hold of a plan before it is driven or exported, from its run folder alone."""
