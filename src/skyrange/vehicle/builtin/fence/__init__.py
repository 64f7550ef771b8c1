"""Fence: its types and state, and the geometry of its zones."""
