"""Reports, plots and figures of runs."""
