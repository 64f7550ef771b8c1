"""Learned detectors: features of windows at link ends, trained models and the monitor that scores with them."""
