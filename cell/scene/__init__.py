"""What the user describes: scene file, scanner keys, real sensors, defaults."""
