"""Pictures drawn by ray casting, and pages for a browser."""
