"""Collision-free paths between configurations, and lines of sweeps, certified between the checked configurations."""
