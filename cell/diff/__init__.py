"""What differs between two plans, or between two executions."""
