"""Controller programs and tables from a run folder."""
