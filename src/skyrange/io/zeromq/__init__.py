"""Zeromq."""
