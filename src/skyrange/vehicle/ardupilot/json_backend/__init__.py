"""Json backend."""
