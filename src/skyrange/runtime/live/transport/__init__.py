"""Transports of a live range: links and control channel between its processes, their addresses and credentials."""
