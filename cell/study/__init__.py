"""Studies: many cached trials of one question, on local processes or a Dask cluster."""
