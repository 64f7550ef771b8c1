"""Missions flown by both autopilots: random ones, those of files, and how far they agree."""
