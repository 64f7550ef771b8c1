"""Placement of aircraft: clear places, airspace, flight plans, and checks of starts."""
