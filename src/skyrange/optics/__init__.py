"""Optics: light rays through a city with aircraft, and what LiDARs and depth cameras return of them."""
