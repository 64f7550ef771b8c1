"""Handlers of single MAVLink messages: heartbeats, RC overrides, parameters."""
