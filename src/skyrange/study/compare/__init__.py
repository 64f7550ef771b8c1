"""Comparisons of two runs, and of two kinds of autopilot."""
