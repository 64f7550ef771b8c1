"""Mavlink state."""
