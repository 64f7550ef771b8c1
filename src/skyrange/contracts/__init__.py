"""Contracts of the components of a range, and the values that pass between them."""
