"""Embree and what is traced with it: scans, occlusion, the measurability matrix and what it predicts."""
