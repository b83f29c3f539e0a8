"""Planning without a model: voxel space of the unknown part, and the expected gain of a view."""
