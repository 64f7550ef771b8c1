"""Validation of scenarios: cross-checks, and errors in the words of a scenario."""
