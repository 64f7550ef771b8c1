"""Kinds of attacks on LiDARs."""
