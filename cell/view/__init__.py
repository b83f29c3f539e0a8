"""What a person looks at: pictures drawn by rays, and the page of a run that opens in any browser."""
