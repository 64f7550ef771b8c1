"""Pilot input: RC channels and what the sticks request."""
