"""Detectors of false navigation: innovations of the estimator, and sensors against each other."""
