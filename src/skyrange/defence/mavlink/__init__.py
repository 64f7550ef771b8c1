"""Defences of MAVLink: what is let through to an autopilot."""
