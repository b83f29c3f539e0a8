"""Wires to robot controllers: joint set-points and a speed go out, states come back. No geometry, no engine."""
