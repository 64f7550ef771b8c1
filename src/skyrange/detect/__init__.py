"""Detectors: monitors that raise alerts, and readers of what a monitor sees."""
