"""From scans to a surface: registration, signed distance, marching cubes, deviation."""
