"""Kinds of faults of ground stations."""
