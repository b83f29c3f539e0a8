"""Which candidates the arm reaches, and the joint set-points at which it does."""
