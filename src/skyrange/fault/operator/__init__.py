"""Kinds of faults of operators."""
