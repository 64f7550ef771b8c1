"""Metrics of one run, or of two, from its record: tracks, links, safety, approvals, defences, differences."""
