"""Open benchmark for model-based view planning: instances, checker, baselines."""
