"""Pairs of an attacked run and its twins: folder, effects, propagation, confidence intervals."""
