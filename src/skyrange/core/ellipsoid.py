"""Constants of the WGS 84 ellipsoid (NIMA TR8350.2)."""

from __future__ import annotations

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)
"""First eccentricity squared."""
