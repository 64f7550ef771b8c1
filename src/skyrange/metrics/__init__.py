"""Metrics of one run, or of two, from its record: tracks, links, receptions, separation, mishaps, differences."""
