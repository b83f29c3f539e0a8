"""Views that sweep: lines at constant speed, proven free, and the arm's way along them."""
