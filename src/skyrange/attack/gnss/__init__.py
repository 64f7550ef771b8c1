"""Attacks on GNSS receivers."""
