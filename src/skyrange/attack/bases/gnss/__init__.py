"""Bases of kinds that act on GNSS receivers, and models of what they do."""
