"""Attacks on flight approval."""
