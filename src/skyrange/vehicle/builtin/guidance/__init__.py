"""Guidance: the reference that position control follows, waypoint legs, and the yaw target."""
