"""A simulated controller behind real bytes, with faults on demand, for tests and for trying a cell out."""
