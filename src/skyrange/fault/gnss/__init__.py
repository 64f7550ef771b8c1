"""Kinds of faults of GNSS receivers and their surroundings."""
