"""Description of the cell by the user: scene file, scanner keys, real sensors, defaults."""
