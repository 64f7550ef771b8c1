"""Detectors of motion that does not fit: telemetry against a motion model, and against other aircraft."""
