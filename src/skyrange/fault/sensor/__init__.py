"""Kinds of faults of sensors."""
