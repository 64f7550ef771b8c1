"""Codecs between bytes and values: MAVLink, missions, ASTM F3411, Remote ID over radio links, and capture files."""
