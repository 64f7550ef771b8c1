"""Detectors that read Remote ID: whether claimed positions, times and strengths of signals can be true."""
