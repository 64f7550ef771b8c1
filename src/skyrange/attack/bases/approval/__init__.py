"""Bases of kinds that act on flight approval."""
