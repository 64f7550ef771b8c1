"""Validation of scenarios: cross-checks, and error messages that name keys of the scenario."""
