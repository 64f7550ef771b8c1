"""Ardupilot."""
