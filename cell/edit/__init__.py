"""Plans changed by hand: what an edit asks for, what it makes of the views, and the new run."""
