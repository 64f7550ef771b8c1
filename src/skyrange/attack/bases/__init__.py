"""Bases of kinds by what an act is: frames in transit, injected frames, transmissions, sensor readings."""
