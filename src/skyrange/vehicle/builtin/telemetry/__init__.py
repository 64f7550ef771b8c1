"""Telemetry: the messages that an aircraft sends, and their rates."""
