"""Benchmark of the view selection: instances, rivals, separate processes, tables. `python -m benchmarks cover`."""
