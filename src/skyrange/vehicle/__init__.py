"""Vehicles: autopilots of several kinds, companion computers, and the routes and links on board."""
