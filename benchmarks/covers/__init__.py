"""View selection examined: instances, rivals, runs in processes of their own, tables. `python -m benchmarks cover`."""
