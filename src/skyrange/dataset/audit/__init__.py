"""Audit of data sets for leaks: what is compared, a classifier that learns the arm, and what it finds."""
