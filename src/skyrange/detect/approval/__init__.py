"""Detectors at the flight approval: flights against what was approved."""
