"""Attacks: kinds with their parameters, and triggers."""
