"""Pairs of an attacked run and its twins: arms, folder, effects, attribution, propagation."""
