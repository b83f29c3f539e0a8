"""The cell as a MuJoCo model: shapes, guarded pairs, collision, clearance."""
