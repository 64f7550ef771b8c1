"""Defences of parameters."""
