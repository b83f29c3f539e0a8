"""Where the part really stands: found from measured points, and a plan taken there."""
