"""`cell live`: a local page on which part, fixtures, table and robot are moved while reach is evaluated."""
