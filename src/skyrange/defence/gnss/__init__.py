"""Plausibility checks of GNSS fixes, between an aircraft's sensors and its autopilot."""
