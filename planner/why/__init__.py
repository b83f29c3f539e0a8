"""Causes of uncovered surface points, and changes of the plan that would cover them."""
