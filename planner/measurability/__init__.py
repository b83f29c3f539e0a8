"""Measurability: the matrix of samples and candidates, its quality, and the coverage of views."""
