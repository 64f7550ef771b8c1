"""Collisions: broad phase, detection and response, and events."""
