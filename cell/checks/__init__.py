"""What is wrong with a scene, and what is doubtful: `cell check`, and what `cell plan` refuses."""
