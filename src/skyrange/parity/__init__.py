"""The builtin autopilot and ArduPilot in the same flights: missions, random missions, reactions to attacks, and flights of logs."""
