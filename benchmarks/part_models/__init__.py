"""Builder of the built-in parts: implicit shapes, marching cubes, and the files that the product ships."""
