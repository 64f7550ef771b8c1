"""Installation of external engines: downloaded from their publisher, verified, and stored."""
