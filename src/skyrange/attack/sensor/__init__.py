"""Attacks on barometers, compasses and inertial sensors."""
