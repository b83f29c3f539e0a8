"""Geometry of the part: triangle mesh, decimated copy, surface samples, closest points, rigid motions."""
