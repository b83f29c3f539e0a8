"""Entry points of earlier installations; the sources of points are in `cell.scan.acquisition`."""
