"""Telemetry: stream profiles, reception in columns, and the belief about each aircraft."""
