"""Campaigns: acts of the catalogue that an adversary starts and stops by what it observes."""
