"""Kinds of faults of the windows of optical sensors."""
