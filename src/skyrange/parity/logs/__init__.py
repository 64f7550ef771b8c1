"""Parity of simulated flights with logs of real ones."""
