"""Space about a part that nobody knows: free, occupied and unknown voxels, and what a view may gain of them."""
