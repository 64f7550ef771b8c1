"""Flight modes."""
