"""Attacks from the ground: a compromised ground station."""
