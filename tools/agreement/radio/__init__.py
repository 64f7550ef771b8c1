"""Comparison of radio engines: the same frames with the same losses, and each engine's own losses."""
