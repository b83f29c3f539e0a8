"""The cell as a MuJoCo model: shapes, checked pairs, collision, clearance."""
