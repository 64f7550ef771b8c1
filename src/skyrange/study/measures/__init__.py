"""Measures of one run: tracks, link statistics, receptions, separation, mishaps."""
