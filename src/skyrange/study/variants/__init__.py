"""Comparison of variants of a scenario: runs of the same seeds with some values changed, and their measures."""
