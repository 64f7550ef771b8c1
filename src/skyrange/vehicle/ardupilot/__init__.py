"""Real ArduPilots: one `arducopter` process per aircraft, behind the same contract as the builtin autopilot."""
