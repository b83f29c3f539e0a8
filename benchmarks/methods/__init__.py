"""The methods examined: what their speed costs in accuracy, and where each of them breaks."""
