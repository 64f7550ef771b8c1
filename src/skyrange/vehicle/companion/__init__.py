"""What does the computer on board do? It broadcasts, listens, and takes the aircraft aside where another is near."""

from skyrange.vehicle.companion.companion import Companion
from skyrange.vehicle.companion.spec import CompanionSpec

__all__ = ["Companion", "CompanionSpec"]
