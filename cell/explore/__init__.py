"""`cell explore`: measure a part without a model, one batch of views after another (docs/explore.md)."""
