"""Rows and files of a run at level `study`, which keeps counts and observations in place of frames and receptions."""
