"""Claimed airspace: volumes as arrays, their outlines, a grid to find them in, and the search for overlaps."""
