"""Who flies: the builtin autopilot, and what else is on board (proxy and companion, as routes)."""
