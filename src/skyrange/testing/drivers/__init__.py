"""Drivers of components under check, and the input that they get."""
