"""Plugins: their registry, where they are found, and the form of a class that kinds that act or listen have."""
