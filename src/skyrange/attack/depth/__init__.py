"""Kinds of attacks on depth cameras."""
