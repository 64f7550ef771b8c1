"""Bases of kinds that inject or alter MAVLink: frames in the name of others, messages in transit, and telemetry."""
