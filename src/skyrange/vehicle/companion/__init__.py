"""Companion computer: it broadcasts and receives Remote ID, and steers the aircraft clear of others."""

from skyrange.vehicle.companion.companion import Companion, CompanionSpec

__all__ = ["Companion", "CompanionSpec"]
