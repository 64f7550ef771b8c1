"""The study of detection range: `python -m tools.detection_range`."""
