"""Kinds of faults of links."""
