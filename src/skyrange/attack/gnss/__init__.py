"""Gnss."""
