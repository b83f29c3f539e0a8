"""`cell study`: many trials of one question, cached one by one, resumed, drawn; on processes or on a Dask cluster."""
