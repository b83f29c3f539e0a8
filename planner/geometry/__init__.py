"""The part's surface: triangle mesh, its decimated copy, samples that stand for it, closest points."""
