"""Names of the services of a federation that no operator has."""

from __future__ import annotations

from typing import Final

DSS: Final = "dss"
"""The discovery and synchronization service."""
AIRSPACE: Final = "airspace"
"""The constraint manager."""
