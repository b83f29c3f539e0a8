"""In which order views are visited, with which joint solution, and the motion through them."""
