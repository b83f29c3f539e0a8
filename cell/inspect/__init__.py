"""Inspection: features of a part, their characteristics, measured values, uncertainty and conformity."""
