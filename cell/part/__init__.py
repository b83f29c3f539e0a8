"""The part to be measured: mesh files in, one checked workpiece in metres out."""
