"""Defences of missions."""
