"""The run folder: written, read back, compiled again."""
