"""Tours: visiting order, configurations and motion over the views."""
