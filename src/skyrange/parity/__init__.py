"""The builtin autopilot and ArduPilot in the same flights: missions, reactions to attacks, and flights of logs."""
