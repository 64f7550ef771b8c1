"""Identity of a flight, the same for runs that said and flew the same, and whether it is so when flown again."""

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


def repeats_to_the_byte(manifest: Mapping[str, Any]) -> bool:
    """Whether a run, flown again, would be the same to the byte: it was virtual, and its engines and medium say so.

    Of a record of a version that did not ask them, the builtin ones are known to be.
    """
    parts = [*(manifest.get("engines") or ()), *([manifest["medium"]] if manifest.get("medium") else [])]
    said = (part.get("repeatable", "bytes" if part.get("kind") == "builtin" else "outcome") for part in parts)
    return not manifest.get("live") and all(one == "bytes" for one in said)
