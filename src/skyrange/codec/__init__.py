"""Bytes ↔ values: MAVLink frames and streams, mission files."""
