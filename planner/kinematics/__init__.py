"""Reachability of candidates: configurations, set-points, rotary table."""
