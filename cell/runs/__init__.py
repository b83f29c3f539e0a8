"""The run folder: written, opened, read into values, verified."""
