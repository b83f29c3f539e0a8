"""`cell why`: what stays open, why, and which single change would measure it."""
