"""Sensors of the aircraft: error models, readings, and the geomagnetic field."""
