"""Wires to robot controllers: send joint set-points and a speed, receive states. No geometry, no physics engine."""
