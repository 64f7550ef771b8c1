"""Telemetry links and fields of frames, for other attacks on telemetry."""

from skyrange.attack.bases.message_fields import put, read_fields, write_fields
from skyrange.attack.bases.telemetry import FROM_AIRCRAFT, telemetry_links

__all__ = ["FROM_AIRCRAFT", "put", "read_fields", "telemetry_links", "write_fields"]
