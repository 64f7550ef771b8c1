"""Attacks on board: a compromised companion computer."""
