"""skyrange: a cyber range for the sky."""

__version__ = "0.1.0"
