"""Detectors that read heartbeats."""
