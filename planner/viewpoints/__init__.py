"""Candidate viewpoints: poses of the scanner, their lines of sight, generation and refinement."""
