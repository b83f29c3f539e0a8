"""`cell explore`: a part without a model is scanned, believed, planned for and scanned again (docs/explore.md)."""
