"""Attacks on telemetry: an on-path tap alters what an autopilot reports, on the way to its receivers."""
