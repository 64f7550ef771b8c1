"""Attacks on the time that aircraft report."""
