"""The builtin autopilot and ArduPilot in the same flights: missions, random missions, and reactions to attacks."""
