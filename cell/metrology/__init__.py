"""Measurement with scanned points: reconstruction of the surface, localisation of the part, hand-eye calibration."""
