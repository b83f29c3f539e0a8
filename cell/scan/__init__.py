"""`cell scan`: execute a plan on a controller, scan, report."""
