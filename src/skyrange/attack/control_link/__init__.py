"""Attacks on control links over the air."""
