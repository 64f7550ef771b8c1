"""Attacks, faults and defences of a scenario made, and what is wrong with them."""
