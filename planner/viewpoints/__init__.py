"""Candidate viewpoints: where a scanner may stand, what a view from there meets, and how candidates are made."""
