"""Programs for controllers from a run folder: what is driven, as values, and its writers."""
