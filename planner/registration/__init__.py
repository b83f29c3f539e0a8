"""Registration and localisation of point clouds, and the geometry of reconstructed surfaces."""
