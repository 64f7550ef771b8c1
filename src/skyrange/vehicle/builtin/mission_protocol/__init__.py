"""Mission protocol."""
