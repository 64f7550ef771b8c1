"""Collision."""
