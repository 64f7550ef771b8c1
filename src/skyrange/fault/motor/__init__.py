"""Kinds of faults of motors."""
