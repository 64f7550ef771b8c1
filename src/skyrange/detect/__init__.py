"""Detectors: monitors that raise alerts, and functions that decode the frames a monitor observes."""
