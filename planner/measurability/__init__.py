"""What each candidate measures: the measurability matrix, its quality, and the coverage of a set of views."""
