"""Mavlink."""
