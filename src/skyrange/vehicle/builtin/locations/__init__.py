"""Locations: coordinate conversion, home, and rally points."""
