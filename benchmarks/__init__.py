"""Benchmarks: time and accuracy in one row, through the public interfaces. Run `python -m benchmarks --help`."""
