"""Missions: stored items, their order, and the execution of their commands."""
