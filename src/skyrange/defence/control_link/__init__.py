"""Defences of control links over the air."""
