"""Sight: what a companion's LiDARs and depth cameras say of the aircraft that radio tells of, and of others."""
