"""Learned detectors of a study: windows of its runs, their labels, training, and model cards."""
