"""Live merge."""
