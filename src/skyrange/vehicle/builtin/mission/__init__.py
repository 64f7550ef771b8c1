"""Mission."""
