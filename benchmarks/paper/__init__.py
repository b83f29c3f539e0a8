"""The paper's tables: its method and ours side by side on the built-in parts."""
