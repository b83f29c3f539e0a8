"""Why a point of the surface stays open, and what would measure it."""
