"""Identity of a flight: runs with the same one said the same and flew the same, whatever their scenarios declare."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skyrange.record.digests import combine_digests


def identify_flight(manifest: Mapping[str, Any]) -> str:
    """32 hex digits over the exact digests of all frames and of all positions of a run; "" for a run without digests.

    The digest of events is left out: an attack that is muted is not part of a flight, nor is when it would have begun.
    """
    digests = manifest.get("digests") or {}
    parts = [str(digests.get(name, "")) for name in ("frames", "truth")]
    return combine_digests(parts) if all(parts) else ""
