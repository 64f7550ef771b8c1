"""Kinds of faults of batteries."""
