"""Bases of detectors by what they read: MAVLink headers, telemetry, receptions of Remote ID, windows of features."""
