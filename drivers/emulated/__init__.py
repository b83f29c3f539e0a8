"""A simulated controller behind a real wire, with faults on demand, for tests and for trying a cell."""
