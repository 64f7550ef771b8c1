"""Merging of the records of a live range's nodes into one record."""
