"""Checks of the sources that `make check` runs and for which no ready tool exists."""
