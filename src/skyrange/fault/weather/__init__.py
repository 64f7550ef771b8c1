"""Kinds of faults that are weather on the way of light."""
